"""Diagnoses of any model by SAT: core-guided to the minimum, then size by size.

It takes over where conflicts are too many or too wide for a search of hitting sets, and where a circuit is no
netlist. The minimum comes first (core_guided.py), all of its size if they are wanted; larger subset-minimal
diagnoses follow size by size (layered.py), until the solver says that there is none besides those found.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from functools import cached_property

from robomend.diagnosis.consistency import Consistency
from robomend.diagnosis.core_guided import CoreGuided, MinimumTooLarge
from robomend.diagnosis.layered import Layered
from robomend.diagnosis.observed import SignedObs, Supposed
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import Bad, NoDiagnosis, SearchState


class BySolver:
    """See the module.

    Args:
        asked_solver: the solver for sizes, None: the best for that.
    """

    def __init__(self, consistency: Consistency, asked_solver: str | None) -> None:
        self._consistency = consistency
        self._cnf = consistency.cnf
        self._clock = consistency.clock
        self._asked_solver = asked_solver

    @cached_property
    def _guided(self) -> CoreGuided:
        cnf = self._cnf
        return CoreGuided(
            cnf.clauses, len(cnf.components), cnf.variables, self._clock, self._consistency.solver
        )

    @cached_property
    def _layered(self) -> Layered:
        cnf = self._cnf
        return Layered(cnf.clauses, len(cnf.components), cnf.variables, self._clock, self._asked_solver)

    def go_on(
        self,
        observed: SignedObs,
        what_if: Supposed,
        options: Options,
        answer: SearchState,
        known: list[Bad],
        size: int,
    ) -> None:
        """Go on from the diagnoses known, all of those below `size` and perhaps some of that size."""
        assumptions = [*observed.numbers, *what_if.numbers]
        forced = len(what_if.abnormal)
        room = None if options.max_size is None else options.max_size - forced
        if room is not None:
            if not known and not self._consistency.any_more(assumptions, known):
                raise NoDiagnosis  # nor are there larger ones
            if room < 0:
                raise MinimumTooLarge
        minima = self._guided.minimum(
            assumptions, max(0, size - forced), room, what_if.healthy | what_if.abnormal
        )
        if options.minimal == "cardinality" or not known:
            already = set(known)
            with closing(minima):
                try:
                    for found in minima:
                        bad = tuple(sorted([*found, *what_if.abnormal]))
                        if bad not in already:
                            if self._cnf.modes:
                                answer.modes[bad] = self._consistency.modes_behind(bad, assumptions)
                            answer.add(bad)
                            known.append(bad)
                finally:
                    answer.cores = self._guided.met
                    answer.at_least = max(answer.at_least, self._guided.paid + forced)
                    if (best := self._guided.best) is not None:
                        answer.best = tuple(sorted([*best, *what_if.abnormal]))
            if not known:
                raise NoDiagnosis
            if options.minimal == "cardinality":
                return
            size = len(known[0]) + 1
        self.layers(observed, what_if, options, answer, known, size)

    def layers(
        self,
        observed: SignedObs,
        what_if: Supposed,
        options: Options,
        answer: SearchState,
        known: list[Bad],
        size: int,
    ) -> None:
        """Enumerate by size from `size` on."""
        assumptions = [*observed.numbers, *what_if.numbers]
        blocked: list[Sequence[int]] = list(known)
        with self._layered.search(assumptions, blocked) as search:
            while options.max_size is None or size <= options.max_size:
                for abnormal, model in search.of_size(size):
                    bad = tuple(abnormal)
                    blocked.append(bad)
                    if self._cnf.modes:
                        answer.modes[bad] = self._consistency.modes_of(bad, model)
                    answer.add(bad)
                if not self._consistency.any_more(assumptions, blocked):
                    return
                size += 1
        if self._consistency.any_more(assumptions, blocked):
            raise MinimumTooLarge

    def close(self) -> None:
        """Free the solvers."""
        for name in ("_guided", "_layered"):
            if name in self.__dict__:
                self.__dict__.pop(name).close()
