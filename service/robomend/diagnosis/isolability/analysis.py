"""All faults against all: what is asked, what is answered. Every answer says whether it is complete."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from time import perf_counter
from typing import Literal as OneOf

from robomend.diagnosis.guided import CheapestHittingSets
from robomend.diagnosis.isolability.comparing import (
    BySignatures,
    Comparison,
    Fault,
    comparison,
    pairs,
)
from robomend.diagnosis.masks import bits
from robomend.diagnosis.oracle import Deadline, OutOfTime
from robomend.errors import OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Atom

MOST_COMPONENTS = 2000
"""Of a model: the matrix has a place for each pair."""

MOST_DOUBLE_FAULTS = 300
"""Double faults that are compared with one another; `double_faults.complete` says whether there are more."""

MOST_DOUBLE_SPLITS = 20
"""Double faults for which the cheapest further observables are looked for."""

MOST_SPLIT = 50
"""Faults of one group, and its rivals, that further observables are to tell apart: goals are pairs."""

Told = OneOf["=", "-", "~", "+", "?"]
"""A place of the matrix: itself, never, sometimes, always, not known (no time)."""


@dataclass(frozen=True, slots=True)
class Further:
    """The cheapest further observables for a group, and what they leave together."""

    atoms: tuple[Atom, ...]
    cost_s: float
    left: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]
    """(fault, rival) that no observable of the model tells apart; the rival is empty: health."""


@dataclass(frozen=True, slots=True)
class Ambiguity:
    """Faults that cannot be told from one another, nor from the rivals, which may show more than they do."""

    faults: tuple[tuple[str, ...], ...]
    rivals: tuple[tuple[str, ...], ...]
    further: Further | None  # None: there was no time to look
    all_looked_at: bool = True  # False: further observables were looked for of the first MOST_SPLIT only


@dataclass(frozen=True, slots=True)
class DoubleFaults:
    """What was found of double faults: bounded, since there are so many."""

    faults: tuple[tuple[str, ...], ...]  # compared; alike ones are represented by one
    detectable: tuple[bool, ...]  # as double faults: some observation has both as a minimal diagnosis
    ambiguities: tuple[Ambiguity, ...]
    complete: bool


@dataclass(frozen=True, slots=True)
class Isolability:
    """What can be detected and told apart; see robomend.diagnosis.isolability for the definitions."""

    observed: tuple[Atom, ...]  # at hand, and spoken of by some rule
    unused: tuple[Atom, ...]  # at hand, and no rule speaks of it
    faults: tuple[tuple[str, ...], ...]
    detectable: tuple[bool | None, ...]  # None: not known
    matrix: tuple[str, ...]  # row i, place j: is fault i told from fault j?
    ambiguities: tuple[Ambiguity, ...]
    undetectable: tuple[Ambiguity, ...]  # one fault each; what would show it
    double_faults: DoubleFaults | None
    exact_by: OneOf["signatures", "search"]
    complete: bool  # False: time ran out
    elapsed_s: float


def isolability(
    cnf: HealthCnf,
    observed: Collection[Atom] | None = None,
    *,
    double: bool = False,
    timeout_s: float | None = 60.0,
) -> Isolability:
    """Return which faults can be detected and told apart.

    Args:
        observed: what is at hand; None: all that the rules speak of, of a circuit its inputs and outputs.
        double: compare double faults, too.

    Raises:
        OptionRefused: more components than MOST_COMPONENTS, or nothing is observed.
    """
    if len(cnf.components) > MOST_COMPONENTS:
        raise OptionRefused(
            f"the model has {len(cnf.components):,} components: isolability is computed for at most "
            f"{MOST_COMPONENTS:,}; check a part of it"
        )
    clock = Deadline()
    clock.start(timeout_s)
    if observed is None:
        observed = (*cnf.inputs, *cnf.outputs) if cnf.circuit else cnf.atoms
    atoms = sorted(set(observed))
    known = tuple(atom for atom in atoms if atom in cnf.atom_variable)
    if not known:
        raise OptionRefused("no rule speaks of anything that is observed: name observables of the model")
    run = _Analysis(cnf, [cnf.atom_variable[atom] for atom in known], clock)
    try:
        return run.all(known, tuple(a for a in atoms if a not in cnf.atom_variable), double)
    finally:
        run.compared.close()


class _Analysis:
    """One analysis; what it knows when the time is up is what it answers."""

    def __init__(self, cnf: HealthCnf, observed: Iterable[int], clock: Deadline) -> None:
        self.cnf = cnf
        self.clock = clock
        self.compared: Comparison = comparison(cnf, observed, clock)
        self.singles: list[Fault] = [(variable,) for variable in cnf.health.values()]
        self.whole = True
        self._atoms = {variable: atom for atom, variable in cnf.atom_variable.items()}

    def all(self, observed: tuple[Atom, ...], unused: tuple[Atom, ...], double: bool) -> Isolability:
        started = perf_counter()
        count = len(self.singles)
        detectable: list[bool | None] = [None] * count
        rows: list[list[Told]] = [["?"] * count for _ in range(count)]
        for index in range(count):
            rows[index][index] = "="
        try:
            self._fill(detectable, rows)
        except OutOfTime:
            self.whole = False
        groups = _groups(rows, detectable)
        ambiguities = [self._ambiguity(self.singles, group, rivals) for group, rivals in groups]
        undetectable = [
            self._split([self.singles[index]], [], [Separation(self.singles[index])])
            for index in range(count)
            if detectable[index] is False
        ]
        doubles = self._double_faults(detectable, groups) if double else None
        return Isolability(
            observed=observed,
            unused=unused,
            faults=tuple(map(self._names, self.singles)),
            detectable=tuple(detectable),
            matrix=tuple("".join(row) for row in rows),
            ambiguities=tuple(ambiguities),
            undetectable=tuple(undetectable),
            double_faults=doubles,
            exact_by="signatures" if isinstance(self.compared, BySignatures) else "search",
            complete=self.whole,
            elapsed_s=perf_counter() - started,
        )

    def _fill(self, detectable: list[bool | None], rows: list[list[Told]]) -> None:
        """Fill the matrix row by row. What shows nothing is told from nothing."""
        for index, fault in enumerate(self.singles):
            detectable[index] = self.compared.shows(fault)
        for index, fault in enumerate(self.singles):
            row = rows[index]
            for other, rival in enumerate(self.singles):
                if other == index:
                    continue
                if not detectable[index] or not self.compared.told(fault, rival):
                    row[other] = "-"
                elif self.compared.always(fault, rival):
                    row[other] = "+"
                else:
                    row[other] = "~"

    # --- double faults ----------------------------------------------------------------------------------

    def _double_faults(
        self, detectable: Sequence[bool | None], groups: Sequence[tuple[list[int], list[int]]]
    ) -> DoubleFaults:
        """Compare double faults with one another and with single ones.

        Where signatures are exact, faults with equal ones are alike in company as well: the first stands for
        all of them, and what shows nothing alone shows nothing there.
        """
        if isinstance(self.compared, BySignatures):
            alike = {other for group, _ in groups for other in group[1:]}
            members = [i for i in range(len(self.singles)) if detectable[i] and i not in alike]
        else:
            members = list(range(len(self.singles)))
        every = pairs(self.singles[index][0] for index in members)
        faults = list(islice(every, MOST_DOUBLE_FAULTS))
        whole = next(every, None) is None
        shown: list[bool] = []
        found: list[Ambiguity] = []
        try:
            for fault in faults:
                shown.append(self.compared.shows(fault))
            for fault in (fault for fault, is_shown in zip(faults, shown, strict=True) if is_shown):
                rivals = [
                    rival
                    for rival in (*(self.singles[index] for index in members), *faults)
                    if rival != fault and not self.compared.told(fault, rival)
                ]
                if not rivals:
                    continue
                if len(found) < MOST_DOUBLE_SPLITS:
                    goals = [Separation(fault, rival) for rival in rivals[:MOST_SPLIT]]
                    found.append(self._split([fault], rivals, goals))
                else:
                    whole = False
                    names = tuple(map(self._names, rivals))
                    found.append(Ambiguity((self._names(fault),), names, None))
        except OutOfTime:
            whole = self.whole = False
        return DoubleFaults(tuple(map(self._names, faults[: len(shown)])), tuple(shown), tuple(found), whole)

    # --- what would split -------------------------------------------------------------------------------

    def _ambiguity(self, faults: Sequence[Fault], group: Sequence[int], rivals: Sequence[int]) -> Ambiguity:
        inside = [faults[index] for index in group]
        outside = [faults[index] for index in rivals]
        goals = [
            Separation(fault, rival)
            for fault in inside[:MOST_SPLIT]
            for rival in (*inside[:MOST_SPLIT], *outside[:MOST_SPLIT])
            if rival != fault
        ]
        return self._split(inside, outside, goals)

    def _split(
        self, faults: Sequence[Fault], rivals: Sequence[Fault], goals: Sequence[Separation]
    ) -> Ambiguity:
        further: Further | None = None
        try:
            further = self._further(cheapest(self.compared, goals, self._cost_s, self.clock))
        except OutOfTime:
            self.whole = False
        return Ambiguity(
            tuple(map(self._names, faults)),
            tuple(map(self._names, rivals)),
            further,
            max(len(faults), len(rivals)) <= MOST_SPLIT,
        )

    def _further(self, found: Cheapest) -> Further:
        left = [(self._names(goal.fault), self._names(goal.rival or ())) for goal in found.beyond]
        cost_s = sum(map(self._cost_s, found.variables))
        return Further(tuple(self._atoms[variable] for variable in found.variables), cost_s, tuple(left))

    def _cost_s(self, variable: int) -> float:
        return self.cnf.costs.get(self._atoms[variable], 1.0)

    def _names(self, fault: Fault) -> tuple[str, ...]:
        return tuple(self.cnf.components[variable - 1] for variable in fault)


def _groups(
    rows: Sequence[Sequence[Told]], detectable: Sequence[bool | None]
) -> list[tuple[list[int], list[int]]]:
    """Return the classes of detectable faults that cannot be told from one another, each with its rivals; a
    fault that can be told from all others is in none.

    "Cannot be told from" is transitive: what i may show, j may show, and so may k.
    """
    found = []
    grouped: set[int] = set()
    for index, row in enumerate(rows):
        never = [other for other, place in enumerate(row) if place == "-"]
        if index in grouped or not never or not detectable[index]:
            continue
        together = [other for other in never if rows[other][index] == "-"]
        grouped.update(together)
        found.append(([index, *together], [other for other in never if other not in together]))
    return found


# --- the cheapest further observables that tell faults apart: implicit hitting sets, by our own engine.
#
# Observing more never hides what could be told before. So for a pair of faults (or a fault and health) the
# sets of further observables that do not tell it apart are closed downwards, and each maximal one is a
# conflict: whatever tells the pair apart observes something outside it.
#
#     cheapest set U that hits the known conflicts ──► all pairs told apart?  yes ──► the answer
#               ▲                                              │ no, not this pair
#               └── the rest of U, grown as long as the pair ◄─┘
#                   stays together, is a new conflict
#
# What cannot be told apart by all observables together is left out, and said.
#
# Source: E. Moreno-Centeno, R. Karp. The implicit hitting set approach. OR 61(2), 2013.

COST_SCALE = 1_000_000
"""Costs are whole microseconds."""


@dataclass(frozen=True, slots=True)
class Separation:
    """A fault that is to be told from a rival, or, without one, from health."""

    fault: Fault
    rival: Fault | None = None

    def reached(self, by: Comparison) -> bool:
        """Whether a comparison does that."""
        return by.shows(self.fault) if self.rival is None else by.told(self.fault, self.rival)


@dataclass(frozen=True, slots=True)
class Cheapest:
    """The cheapest further observables, as variables; none if no goal can be reached."""

    variables: tuple[int, ...]
    reached: tuple[Separation, ...]
    beyond: tuple[Separation, ...]  # no observable of the model helps


def cheapest(
    now: Comparison, goals: Sequence[Separation], cost_s: Callable[[int], float], clock: Deadline
) -> Cheapest:
    """Return a cheapest set of further observables that reaches every goal that can be reached.

    Raises:
        OutOfTime: the clock ran out.
    """
    faults = {fault for goal in goals for fault in (goal.fault, goal.rival) if fault is not None}
    relevant: set[int] = set()
    for fault in faults:
        relevant |= now.relevant(fault)
    candidates = sorted(relevant)
    tried = _Tried(now, candidates)
    try:
        everything = (1 << len(candidates)) - 1
        within = tuple(goal for goal in goals if tried.reached(goal, everything))
        beyond = tuple(goal for goal in goals if goal not in within)
        if not within:
            return Cheapest((), (), beyond)
        sets = CheapestHittingSets([max(1, round(cost_s(v) * COST_SCALE)) for v in candidates], clock)
        try:
            while True:
                chosen = sets.next()
                assert chosen is not None, "observing everything reaches these goals"
                missed = next((goal for goal in within if not tried.reached(goal, chosen)), None)
                if missed is None:
                    return Cheapest(tuple(candidates[bit] for bit in bits(chosen)), within, beyond)
                sets.hit(everything & ~_grown(tried, missed, chosen, bits(everything & ~chosen)))
        finally:
            sets.close()
    finally:
        tried.close()


def _grown(tried: _Tried, goal: Separation, chosen: int, others: Sequence[int]) -> int:
    """Return a maximal superset of `chosen` by `others` that does not reach the goal either: all of them at
    once, or one half and then the other.
    """
    more = chosen
    for bit in others:
        more |= 1 << bit
    if more == chosen or not tried.reached(goal, more):
        return more
    if len(others) == 1:
        return chosen
    middle = len(others) // 2
    return _grown(tried, goal, _grown(tried, goal, chosen, others[:middle]), others[middle:])


class _Tried:
    """Comparisons with further observables; the one asked last is kept, as goals are asked in a row."""

    def __init__(self, now: Comparison, candidates: Sequence[int]) -> None:
        self._now = now
        self._candidates = candidates
        self._mask = 0
        self._with: Comparison | None = None

    def reached(self, goal: Separation, mask: int) -> bool:
        if self._with is None or mask != self._mask:
            self.close()
            self._mask = mask
            self._with = self._now.observing(self._candidates[bit] for bit in bits(mask))
        return goal.reached(self._with)

    def close(self) -> None:
        if self._with is not None:
            self._with.close()
            self._with = None
