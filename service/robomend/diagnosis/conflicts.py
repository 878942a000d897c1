"""Minimal conflicts: components that cannot all be healthy, and the observations and rules that say so.

A SAT core over health and observation literals is a conflict, but seldom a minimal one. Deleting one literal
at a time makes it so: first the components, with all of OBS assumed, then the observations, for those
components. A conflict rests on its own observations only, so it is kept in a library and used again whenever
they are observed again: on a robot that is diagnosed many times most conflicts are known before the search
starts.

Where all clauses are Horn, as those of a component model are, unit propagation decides whether literals
contradict them. The search then makes its conflicts minimal by propagating from the few literals of the core,
in time that does not grow with the model, instead of asking the solver with all of OBS for each component.
Such a conflict is minimal for its own observations; that no other observation makes it smaller is settled at
the end, for those that are reported (robomend.diagnosis.base).

Sources:
    J. de Kleer, B. Williams. Diagnosing multiple faults. AIJ 32(1), 1987 (conflicts with their environment).
    W. Dowling, J. Gallier. Linear-time algorithms for testing the satisfiability of propositional Horn
    formulae. JLP 1(3), 1984.
    J. Marques-Silva. Minimal unsatisfiability: models, algorithms and applications. ISMVL 2010 (deletion).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from robomend.diagnosis.explanations import explain_conflict
from robomend.diagnosis.masks import mask_of
from robomend.diagnosis.observed import SignedObs, Supposed
from robomend.diagnosis.oracle import Oracle
from robomend.diagnosis.reasons import Reasons
from robomend.diagnosis.result import Conflict
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Atom, Literal

LIBRARY_SIZE = 20_000


@dataclass(slots=True)
class Known:
    """A minimal conflict in numbers; its words are made when they are first asked for."""

    mask: int  # bit i: component i
    components: tuple[int, ...]  # health variables, ascending
    observations: tuple[int, ...]  # signed variables
    words: Conflict | None = None
    premises: frozenset[int] = field(init=False)  # the observations, to look things up in

    def __post_init__(self) -> None:
        self.premises = frozenset(self.observations)


class Conflicts:
    """Finds, keeps and words the minimal conflicts of one model."""

    def __init__(self, cnf: HealthCnf, reasons: Reasons) -> None:
        self._cnf = cnf
        self._reasons = reasons
        self.horn = all(sum(literal > 0 for literal in clause) < 2 for clause in cnf.clauses)
        self._by_observation: dict[int, list[Known]] = {}
        self._size = 0

    def applicable(self, observed: SignedObs) -> list[Known]:
        """Return the known conflicts whose observations are all observed now, the smallest first.

        With other observations around, some contain others; those come later.
        """
        if not self._size:
            return []
        seen = observed.seen
        by_observation = self._by_observation
        found: list[Known] = []
        for number in by_observation.keys() & seen:
            found += [known for known in by_observation[number] if known.premises <= seen]
        if 0 in by_observation:  # conflicts of the model alone
            found += by_observation[0]
        if len(found) > 1:
            found.sort(key=_width)
        return found

    def keep(self, known: Known) -> None:
        """Put a conflict into the library. It is emptied when full: it only saves time."""
        if self._size >= LIBRARY_SIZE:
            self._by_observation.clear()
            self._size = 0
        key = min(known.observations, default=0)  # what is not ok is rare, so that few others are looked at
        shelf = self._by_observation.setdefault(key, [])
        if not any(one.mask == known.mask and one.observations == known.observations for one in shelf):
            shelf.append(known)
            self._size += 1

    def shrink(self, oracle: Oracle, core: Iterable[int], observed: SignedObs, supposed: Supposed) -> Known:
        """Return a conflict inside a core, minimal for its own observations: enough to search with."""
        core = list(core)
        if not self.horn or oracle.propagate(core)[0]:
            return self.minimise(oracle, core, observed, supposed)
        n = len(self._cnf.components)
        components = [lit for lit in core if 0 < lit <= n and lit not in supposed.healthy]
        observations = [lit for lit in core if not 0 < lit <= n or lit in supposed.healthy]
        propagate = oracle.propagate
        for part in (components, observations) if len(components) > 1 else (observations,):
            rest = observations if part is components else components
            index = 0
            while index < len(part):
                literal = part.pop(index)
                if propagate(part + rest)[0]:
                    part.insert(index, literal)
                    index += 1
        components.sort()
        return Known(mask_of(components), tuple(components), tuple(observations))

    def minimise(self, oracle: Oracle, core: Iterable[int], observed: SignedObs, supposed: Supposed) -> Known:
        """Return a minimal conflict inside a core. Those supposed healthy count as observations here."""
        n = len(self._cnf.components)
        fixed = supposed.numbers
        fixed_set = set(fixed)
        core = list(core)
        components = [lit for lit in core if 0 < lit <= n and lit not in fixed_set]
        if len(components) > 1:
            background = [*fixed, *observed.numbers]
            components, core = self._shrink_components(oracle, components, background, core)
        observations = [lit for lit in core if not 0 < lit <= n or lit in fixed_set]
        index = 0
        while index < len(observations):
            trial = observations[:index] + observations[index + 1 :]
            if oracle.sat(components + trial):
                index += 1
            else:
                left = set(oracle.core() or ())
                observations = [lit for lit in trial if lit in left]
        components.sort()
        return Known(mask_of(components), tuple(components), tuple(observations))

    @staticmethod
    def _shrink_components(
        oracle: Oracle, components: list[int], background: list[int], core: list[int]
    ) -> tuple[list[int], list[int]]:
        """Delete components one by one, with the whole of OBS assumed; return the rest and the last core."""
        index = 0
        while index < len(components):
            trial = components[:index] + components[index + 1 :]
            if oracle.sat(trial + background):
                index += 1
            else:
                core = oracle.core() or []
                left = set(core)
                components = [lit for lit in trial if lit in left]
        return components, core

    def in_words(self, known: Known, observed: SignedObs) -> Conflict:
        """Return the conflict with its observations, rules and sentence."""
        if known.words is None:
            cnf = self._cnf
            # What is supposed healthy is no suspect, but a premise of the conflict, and is named with them.
            n = len(cnf.components)
            healthy = sorted([*known.components, *(v for v in known.observations if 0 < v <= n)])
            names = tuple(cnf.components[variable - 1] for variable in healthy)
            literals = tuple(
                observed.literal(number)
                if number in observed.seen
                else Literal(Atom("ab", (cnf.components[-number - 1],)))
                for number in known.observations
                if not 0 < number <= n
            )
            used = self._reasons.rules([*known.components, *known.observations])
            rules = tuple(cnf.rules[index].text for index in used)
            known.words = Conflict(names, literals, rules, explain_conflict(cnf, names, literals, rules))
        return known.words


def _width(known: Known) -> int:
    return known.mask.bit_count()
