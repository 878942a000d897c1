"""Minimal conflicts: components that cannot all be healthy, and the observations and rules that say so.

A SAT core over health and observation literals is a conflict, but seldom a minimal one. Leaving literals out
makes it so (shrinking.py): first components, with all of OBS assumed, then observations, for those
components. A conflict rests on its own observations only, so it is kept in a library and used again whenever
they are observed again: on a robot that is diagnosed many times most conflicts are known before the search
starts.

Where all clauses are Horn, unit propagation decides whether literals contradict them. The search then makes
its conflicts smaller by propagating from the few literals of the core, in time that does not grow with the
model, instead of asking the solver with all of OBS for each component. Such a conflict is minimal for its own
observations; that no other observation makes it smaller is settled at the end, for those that are reported
(justification.py).

Sources:
    J. de Kleer, B. Williams. Diagnosing multiple faults. AIJ 32(1), 1987 (conflicts with their environment).
    W. Dowling, J. Gallier. Linear-time algorithms for testing the satisfiability of propositional Horn
    formulae. JLP 1(3), 1984.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

from pysat.solvers import Solver

from robomend.diagnosis.derivations import Derivation, Derivations, TooManyEnvironments
from robomend.diagnosis.explanations import conflict_in_words
from robomend.diagnosis.masks import mask_of, members
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs, Supposed
from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.diagnosis.result import Conflict
from robomend.diagnosis.shrinking import TRIED_SINGLY, Extract, Witnesses, minimised, shrunk
from robomend.model.cnf import Clause, HealthCnf

# --- which rules a contradiction rests on.
#
# Unit propagation by hand, from the contradictory literals, remembering the clause that forced each new
# literal; at the first falsified clause the reasons are followed back. Each clause met on the way is part
# of an unsatisfiable core. It takes time in proportion to what is propagated, not to the model. Where
# propagation alone does not refute, a solver with one selector a rule gives the core instead; it is built
# at the first need.

WATCHED_S = 8e-6
"""A clause, to be ready for the first contradiction."""

SLICES = 10
SLICE_CONFLICTS = 2_000
"""For the fallback: a refutation that takes more is reported with the rules of the core before."""


class Reasons:
    """Finds the rules behind contradictory literals of one model."""

    def __init__(self, cnf: HealthCnf, clock: Deadline) -> None:
        self._cnf = cnf
        self._clock = clock
        self._solver: Solver | None = None

    @cached_property
    def _watch(self) -> dict[int, list[int]]:
        """Literal -> the clauses that become shorter when it is true."""
        watch: dict[int, list[int]] = defaultdict(list)
        for index, clause in enumerate(self._cnf.clauses):
            for literal in clause:
                watch[-literal].append(index)
        return dict(watch)

    @property
    def prepared_in_s(self) -> float:
        """What the first call takes longer than the others."""
        return 0.0 if "_watch" in self.__dict__ else WATCHED_S * len(self._cnf.clauses)

    @cached_property
    def _units(self) -> list[int]:
        """The clauses that hold of themselves: of length one, or empty."""
        return [index for index, clause in enumerate(self._cnf.clauses) if len(clause) < 2]

    def rules(self, literals: Sequence[int]) -> tuple[int, ...]:
        """Return the rules, as indices into cnf.rules, of an unsatisfiable core of SD with these literals.

        Empty when they do not contradict SD, or when the fallback found no refutation within its budget or
        the time that is left.
        """
        used = self._by_propagation(literals)
        if used is None:
            return self._by_selectors(literals)
        origins = self._cnf.origins
        return tuple(sorted({origins[index] for index in used}))

    def _by_propagation(self, literals: Sequence[int]) -> set[int] | None:
        clauses, watch = self._cnf.clauses, self._watch
        reason: dict[int, int | None] = dict.fromkeys(literals)  # true literal -> the clause that forced it
        queue = list(reason)
        for index in self._units:
            clause = clauses[index]
            if not clause:
                return {index}
            if -clause[0] in reason:
                return self._back(index, reason)
            if clause[0] not in reason:
                reason[clause[0]] = index
                queue.append(clause[0])
        for literal in queue:  # grows while it is read
            for index in watch.get(literal, ()):
                unit = 0
                for other in clauses[index]:
                    if other in reason:
                        break
                    if -other not in reason:
                        if unit:
                            break
                        unit = other
                else:
                    if not unit:
                        return self._back(index, reason)
                    reason[unit] = index
                    queue.append(unit)
        return None

    def _back(self, falsified: int, reason: dict[int, int | None]) -> set[int]:
        clauses = self._cnf.clauses
        used = {falsified}
        todo = [falsified]
        while todo:
            for literal in clauses[todo.pop()]:
                index = reason.get(-literal)
                if index is not None and index not in used:
                    used.add(index)
                    todo.append(index)
        return used

    def _by_selectors(self, literals: Sequence[int]) -> tuple[int, ...]:
        top = self._cnf.variables
        count = len(self._cnf.rules)
        if self._solver is None:
            pairs = zip(self._cnf.clauses, self._cnf.origins, strict=True)
            self._solver = Solver(
                name="minisat22",
                bootstrap_with=([*clause, -(top + 1 + origin)] for clause, origin in pairs),
            )
        solver = self._solver
        selectors = list(range(top + 1, top + 1 + count))
        refuted = False
        while self._refutes(solver, [*literals, *selectors]):
            refuted = True
            core = [literal for literal in solver.get_core() or [] if literal > top]
            if len(core) >= len(selectors):
                break
            selectors = core
        if not refuted:
            return ()
        return tuple(sorted(selector - top - 1 for selector in selectors))

    def _refutes(self, solver: Solver, literals: list[int]) -> bool:
        """Return whether the solver refutes the literals, within its budget and the time that is left."""
        for _ in range(SLICES):
            if not self._clock.left_s:
                return False
            solver.conf_budget(SLICE_CONFLICTS)
            answer = solver.solve_limited(assumptions=literals)
            if answer is not None:
                return answer is False
        return False

    def close(self) -> None:
        """Free the fallback's solver."""
        if self._solver is not None:
            self._solver.delete()
            self._solver = None


LIBRARY_SIZE = 20_000
WORDS_KEPT = 20_000

SHRINKING_CALLS = 256
"""Propagations to make a conflict of a search smaller: it is as right when it is not minimal."""

ASKED_AT_ONCE = 3
"""Components of a core whose clauses are not put into a solver of their own, if nothing else is asked."""


@dataclass(slots=True)
class Known:
    """A conflict in numbers; its words are made when they are first asked for."""

    mask: int  # bit i: component i
    components: tuple[int, ...]  # health variables, ascending
    observations: tuple[int, ...]  # signed variables
    minimal: bool = True  # for its own observations
    rules: tuple[int, ...] | None = None  # indices into cnf.rules; None: to be found
    words: Conflict | None = None
    under: SignedObs | None = None  # the observations all of which it is known to be minimal for

    @classmethod
    def of(cls, components: Iterable[int], observations: Iterable[int], minimal: bool) -> Known:
        """Return the conflict of these health variables and signed variables."""
        ordered = tuple(sorted(components))
        return cls(mask_of(ordered), ordered, tuple(observations), minimal)


class Conflicts:
    """Finds, keeps and words the minimal conflicts of one model."""

    def __init__(self, cnf: HealthCnf, reasons: Reasons, clock: Deadline) -> None:
        self._cnf = cnf
        self._reasons = reasons
        self._clock = clock
        self.horn = all(sum(literal > 0 for literal in clause) < 2 for clause in cnf.clauses)
        self._by_observation: dict[int, list[Known]] = {}
        self._size = 0
        self._words: dict[tuple[int, ...], Conflict] = {}  # components, 0, observations -> in words
        self._single_steps: dict[Derivation, Known] = {}

    @cached_property
    def _derivations(self) -> Derivations | None:
        return Derivations(self._cnf) if Derivations.suit(self._cnf) else None

    def all_of(self, observed: SignedObs, supposed: Supposed) -> list[Derivation] | None:
        """Return conflicts among which are all minimal ones, or None where they cannot be listed."""
        if self._derivations is None:
            return None
        try:
            return self._derivations.conflicts(observed, supposed, self._clock.check)
        except TooManyEnvironments:
            return None

    def derived(self, one: Derivation, oracle: Oracle, supposed: Supposed) -> Known:
        """Return a conflict that was derived; its components are minimal, its observations are made so."""
        # Of a single step most were met before. (To hash a derivation of many may take as long as to list its
        # ways.)
        again = not one.before and supposed is NOTHING_SUPPOSED
        if again and (met := self._single_steps.get(one)) is not None:
            return met
        found = self._derived(one, oracle, supposed)
        if again:
            if len(self._single_steps) >= WORDS_KEPT:
                self._single_steps.clear()
            self._single_steps[one] = found
        return found

    def _derived(self, one: Derivation, oracle: Oracle, supposed: Supposed) -> Known:
        assert self._derivations is not None
        components, steps = members(one.mask), one.steps()
        premises = one.premises
        if one.before:
            premises = tuple(dict.fromkeys(atom for step in steps for atom in step.premises))
        observations = (-one.head, *premises) if one.head else premises
        if supposed is NOTHING_SUPPOSED and not self._derivations.may_spare(one.mask, steps):
            rules = tuple(sorted({step.origin for step in steps})) if one.before else (one.origin,)
            return Known(one.mask, components, observations, rules=rules)
        rest, _ = shrunk(
            [*observations, *supposed.healthy],
            lambda some: None if oracle.propagate([*components, *some])[0] else some,
            SHRINKING_CALLS,
        )
        return Known(one.mask, components, tuple(rest))

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
            found += [known for known in by_observation[number] if seen.issuperset(known.observations)]
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
        """Return a conflict inside a core, minimal for its own observations if that takes few questions."""
        core = list(core)
        if not self.horn or oracle.propagate(core)[0]:
            return self.minimise(oracle, core, observed, supposed)
        components, observations = apart(core, len(self._cnf.components), supposed.healthy)

        def refute(literals: list[int]) -> list[int] | None:
            self._clock.check()
            return None if oracle.propagate(literals)[0] else literals

        components, minimal = shrunk(components, lambda some: refute(some + observations), SHRINKING_CALLS)
        observations, _ = shrunk(observations, lambda some: refute(components + some), SHRINKING_CALLS)
        return Known.of(components, observations, minimal)

    def minimise(
        self,
        oracle: Oracle,
        core: Iterable[int],
        observed: SignedObs,
        supposed: Supposed,
        needed: Collection[int] = (),
        *,
        components_only: bool = False,
        calls: int | None = None,
    ) -> Known:
        """Return a minimal conflict inside a core. Those supposed healthy count as observations here.

        Nothing follows from an abnormal component of a weak fault model, so there the clauses of the core's
        components are all that matter: a solver of those few answers in no time. To make it takes longer than
        to ask the solver of all about two or three components.

        Args:
            needed: components that are known to be needed.
            components_only: leave it at these; what they rest on may be more than it must.
            calls: of the solver at most, None: a thousand; where that is too few the conflict says so.

        Raises:
            OutOfTime.
        """
        components, observations = apart(core, len(self._cnf.components), supposed.healthy)
        asked_at_once = ASKED_AT_ONCE if components_only else 0
        if not self._cnf.weak or self._mostly_nobodys or len(components) <= asked_at_once:
            background = [*supposed.numbers, *observed.numbers]
            kept, rest, minimal = minimised(
                oracle,
                components,
                observations,
                background,
                set(needed),
                components_only=components_only,
                calls=calls,
            )
        else:
            healthy = frozenset(components) | supposed.healthy
            with Extract(self._clauses_of(healthy), components, self._clock, oracle.name) as extract:
                background = extract.known((*supposed.healthy, *observed.numbers))
                witnesses = None
                if len(components) > TRIED_SINGLY:
                    fixed = frozenset(map(abs, background))
                    witnesses = Witnesses(extract.clauses, len(components), fixed, self._clock.check)
                kept, rest, minimal = minimised(
                    extract.oracle,
                    extract.known(components),
                    extract.known(observations),
                    background,
                    set(extract.known(needed)),
                    witnesses,
                    components_only=components_only,
                    calls=calls,
                )
                kept, rest = extract.original(kept), extract.original(rest)
        found = Known.of(kept, rest, minimal)
        found.under = observed
        return found

    @cached_property
    def _mostly_nobodys(self) -> bool:
        """Whether so many clauses name no component that those of a few components are much of the model."""
        return 4 * len(self._clauses_by_component.get(0, ())) > len(self._cnf.clauses)

    def rough(self, core: Iterable[int], supposed: Supposed) -> Known:
        """Return the conflict that a core is, as it is."""
        components, observations = apart(core, len(self._cnf.components), supposed.healthy)
        return Known.of(components, observations, minimal=False)

    def _clauses_of(self, healthy: frozenset[int]) -> list[Clause]:
        """Return the clauses of a weak fault model that say something where only these are healthy."""
        of = self._clauses_by_component
        found = list(of.get(0, ()))
        for component in healthy:
            for clause in of.get(component, ()):
                if all(
                    -literal in healthy for literal in clause if -len(self._cnf.components) <= literal < 0
                ):
                    found.append(clause)
        return found

    @cached_property
    def _clauses_by_component(self) -> dict[int, list[Clause]]:
        """Component -> the clauses that name it before any other component; 0: those that name none."""
        last = -len(self._cnf.components)
        found: dict[int, list[Clause]] = defaultdict(list)
        for clause in self._cnf.clauses:
            for literal in clause:  # mostly it is the first one
                if last <= literal < 0:
                    found[-literal].append(clause)
                    break
            else:
                found[0].append(clause)
        return found

    def reserve_telling(self) -> None:
        """Keep the time that it takes to be ready to tell conflicts; raise OutOfTime if it is not left."""
        self._clock.reserve_more(self._reasons.prepared_in_s)

    def in_words(self, known: Known) -> Conflict:
        """Return the conflict with its observations, rules and sentence."""
        if known.words is not None:
            return known.words
        key = (*known.components, 0, *known.observations)
        words = self._words.get(key)
        if words is None or words.minimal != known.minimal:
            if len(self._words) >= WORDS_KEPT:
                self._words.clear()
            words = self._words[key] = self._told(known)
        known.words = words
        return words

    @cached_property
    def _rule_of_gate(self) -> dict[int, int]:
        """Component -> its one rule, which its conflicts rest on; empty where rules are not like that."""
        cnf = self._cnf
        found: dict[int, int] = {}
        if cnf.circuit and cnf.weak:
            n = len(cnf.components)
            for clause, origin in zip(cnf.clauses, cnf.origins, strict=True):
                health = clause[0] if clause and -n <= clause[0] < 0 else 0
                if not health or found.setdefault(-health, origin) != origin:
                    return {}
        return found

    def _told(self, known: Known) -> Conflict:
        cnf = self._cnf
        # What is supposed healthy is no suspect, but a premise of the conflict, and is named with them.
        n = len(cnf.components)
        healthy = sorted([*known.components, *(v for v in known.observations if 0 < v <= n)])
        names = tuple([cnf.components[variable - 1] for variable in healthy])
        literals = tuple([cnf.literal_of(number) for number in known.observations if not 0 < number <= n])
        used = known.rules
        if used is None and known.components and self._rule_of_gate:
            used = tuple(sorted([self._rule_of_gate[component] for component in known.components]))
        elif used is None:
            used = self._reasons.rules([*known.components, *known.observations])
        rules = tuple([cnf.rules[index].text for index in used])
        return conflict_in_words(cnf, names, literals, rules, known.minimal)


def apart(core: Iterable[int], n: int, healthy: Collection[int] = ()) -> tuple[list[int], list[int]]:
    """Return the components of a core, variables 1 … n, and what it rests on: what was seen, `healthy`."""
    components: list[int] = []
    rest: list[int] = []
    for literal in core:
        (components if 0 < literal <= n and literal not in healthy else rest).append(literal)
    return components, rest


def _width(known: Known) -> int:
    return known.mask.bit_count()
