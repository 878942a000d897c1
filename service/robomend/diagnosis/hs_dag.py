"""A baseline: Reiter's hitting-set DAG with a SAT solver as the theorem prover.

Breadth first; an inner node is labelled with a conflict that its path H(n) does not hit, and has one edge
for each member of the conflict. A node without such a conflict is a diagnosis: H(n) itself.

    reuse    a known label that H(n) does not hit is used again; nodes with the same H(n) are one node
    close    a node whose H(n) contains a diagnosis is not grown

Labels are minimal conflicts, none of which contains another, so that nothing is ever to be pruned, and the
correction of Greiner, Smith and Wilkerson (AIJ 41(1), 1989), which is of pruning, has nothing to correct.

Source: R. Reiter. A theory of diagnosis from first principles. AIJ 32(1), 1987.
"""

from __future__ import annotations

from robomend.diagnosis.base import BaseEngine
from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.observed import SignedObs, Supposed
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import Bad, NoDiagnosis, SearchState

Path = frozenset[int]
"""H(n) of a node."""


class HsDagEngine(BaseEngine):
    """See the module."""

    name = "hs_dag"

    def _search(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        self._clock.check()
        labels: list[Path] = []
        diagnoses: list[Path] = []
        level: dict[Path, None] = {Path(): None}
        depth = len(what_if.abnormal)
        while level:
            if options.max_size is not None and depth > options.max_size:
                if self._consistency.any_more([*observed.numbers, *what_if.numbers], answer.found):
                    raise MinimumTooLarge
                if not answer.found:
                    raise NoDiagnosis
                return
            below: dict[Path, None] = {}
            for path in level:
                if any(diagnosis <= path for diagnosis in diagnoses):
                    continue
                self._clock.check()
                label = next((one for one in labels if one.isdisjoint(path)), None)
                if label is None:
                    label = self._conflict_outside(path, observed, what_if, answer)
                    if label is None:
                        diagnoses.append(path)
                        continue
                    labels.append(label)
                for edge in label:
                    below[path | {edge}] = None
            if options.minimal == "cardinality" and answer.found:
                return
            level = below
            depth += 1

    def _conflict_outside(
        self, path: Path, observed: SignedObs, what_if: Supposed, answer: SearchState
    ) -> Path | None:
        """Return a conflict that a path does not hit; None: it is a diagnosis, which is noted."""
        abnormal = path | what_if.abnormal
        oracle = self._consistency.oracle
        assumptions = [variable for variable in self._consistency.health if variable not in abnormal]
        assumptions += observed.numbers
        assumptions += [-variable for variable in what_if.abnormal]
        if oracle.sat(assumptions):
            bad: Bad = tuple(sorted(abnormal))
            if self.cnf.modes:
                answer.modes[bad] = self._consistency.modes_of(bad, oracle.model() or ())
            answer.add(bad)
            return None
        known = self._conflicts.minimise(oracle, oracle.core() or (), observed, what_if)
        if not known.mask:
            raise NoDiagnosis
        answer.known.append(known)
        return Path(known.components)
