"""Two ways to compare faults, behind one face: by signatures where these are exact, by search elsewhere.

Signatures of a definite system description are exact, and as fast as reading the model. The six schemes
give rules `healthy components and atoms -> atom`, with one rule for each atom. Then an atom is derived in
one way only, and the observed ones cut its derivation:

    cone(u)        the components in the derivation of u from the *other* observed atoms, all taken as true
    leaves(u)      the observed atoms that it ends at
    S(c)           the signature of c: the observed atoms u with c ∈ cone(u)

What is seen is a set N of atoms that are not so. Its minimal conflicts are the cones of those u ∈ N with no
leaf in N: whatever is derived otherwise contains the cone of such a one. So, for single faults i and j,

    i is detectable iff S(i) ≠ ∅                       (`not u` for one u ∈ S(i), all else in order)
    i is told from j iff S(i) ⊄ S(j)                   (the same with u ∈ S(i) ∖ S(j))
    i is always told from j iff also S(i) ∩ S(j) = ∅   (else both explain `not u` of the intersection)

which is the fault signature matrix of the field, whose rows are the possible conflicts. A double fault {a, b}
is a minimal diagnosis of what is seen iff every cone seen is hit by one of the two and neither hits all of
them; up to three atoms, none a leaf of another, show all that can be shown of it and a rival.

Sources:
    B. Pulido, C. Alonso González. Possible conflicts: a compilation technique for consistency-based
    diagnosis. IEEE Trans. SMC B 34(5), 2004.
    M. O. Cordier et al. Conflicts versus analytical redundancy relations. IEEE Trans. SMC B 34(5), 2004
    (signatures, and what they assume). That one rule an atom makes them exact is shown above, and tested.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import NamedTuple, Protocol

from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.model.cnf import HealthCnf


class Cone(NamedTuple):
    """How an atom is derived from observed ones."""

    components: int  # mask: bit i is health variable i + 1
    leaves: frozenset[int]  # observed variables


@dataclass(frozen=True)
class Definite:
    """The rules of a definite system description, as a graph."""

    components: int
    rule: Mapping[int, tuple[int, tuple[int, ...]]]
    """Variable -> what its one rule needs: the mask of healthy components, and variables that are true."""
    heads: Mapping[int, tuple[int, ...]]
    """Variable, of health as well -> what it helps to derive."""
    grounded: frozenset[int]
    """What follows from all components being healthy, and nothing observed: it has no circle below it."""

    @classmethod
    def of(cls, cnf: HealthCnf) -> Definite | None:
        """Return the graph, or None: a rule is not definite, or an atom has two."""
        count = len(cnf.components)
        rule: dict[int, tuple[int, tuple[int, ...]]] = {}
        heads: dict[int, list[int]] = {}
        for clause in cnf.clauses:
            positive = [literal for literal in clause if literal > 0]
            if len(positive) != 1 or positive[0] <= count:
                return None
            head = positive[0]
            needed = tuple(dict.fromkeys(-literal for literal in clause if literal < 0))
            if head in needed:
                continue  # it says nothing
            mask = sum(1 << (variable - 1) for variable in needed if variable <= count)
            body = tuple(variable for variable in needed if variable > count)
            if head in rule:
                if rule[head] == (mask, body):
                    continue  # said twice
                return None
            rule[head] = (mask, body)
            for variable in needed:
                heads.setdefault(variable, []).append(head)
        return cls(
            count, rule, {variable: tuple(found) for variable, found in heads.items()}, _grounded(rule, heads)
        )


def _grounded(
    rule: Mapping[int, tuple[int, tuple[int, ...]]], heads: Mapping[int, Sequence[int]]
) -> frozenset[int]:
    missing = {head: len(body) for head, (_, body) in rule.items()}
    pending = [head for head, count in missing.items() if not count]
    found = set(pending)
    while pending:
        for head in heads.get(pending.pop(), ()):
            missing[head] -= 1
            if not missing[head]:
                found.add(head)
                pending.append(head)
    return frozenset(found)


class Signatures:
    """The signatures of the components over some observed variables; made as they are asked for."""

    def __init__(self, definite: Definite, observed: Iterable[int]) -> None:
        self.observed = frozenset(observed)
        self._definite = definite
        self._hidden: dict[int, Cone | None] = {}
        self._cones: dict[int, Cone | None] = {}
        self._signatures: dict[int, frozenset[int]] = {}

    def of(self, component: int) -> frozenset[int]:
        """Return the observed variables that rest on a component (a health variable)."""
        found = self._signatures.get(component)
        if found is None:
            # What is reached has the component in its cone, if it has one: there is one rule for each atom.
            reached = self.observed.intersection(self.reached(component))
            found = frozenset(v for v in reached if v in self._definite.grounded or self.cone(v))
            self._signatures[component] = found
        return found

    def reached(self, component: int) -> set[int]:
        """Return what a component helps to derive, up to the first observed variable on each way."""
        met: set[int] = set()
        pending = list(self._definite.heads.get(component, ()))
        while pending:
            variable = pending.pop()
            if variable not in met:
                met.add(variable)
                if variable not in self.observed:
                    pending += self._definite.heads.get(variable, ())
        return met

    def relevant(self, component: int) -> set[int]:
        """Return the hidden variables whose observation could change the signature of a component."""
        reached = self.reached(component)
        met: set[int] = set()
        pending = list(reached)
        while pending:
            variable = pending.pop()
            if variable in met:
                continue
            met.add(variable)
            if variable in reached or variable not in self.observed:
                _, body = self._definite.rule.get(variable, (0, ()))
                pending += body
        return met - self.observed

    def cone(self, variable: int) -> Cone | None:
        """Return how an observed variable follows from the others; None: it does not."""
        if variable not in self._cones:
            found = self._derived(variable)
            self._cones[variable] = None if found is None or variable in found.leaves else found
        return self._cones[variable]

    def _derived(self, top: int) -> Cone | None:
        """Return the derivation of a variable by its rule. Hidden ones on its way are remembered.

        What needs itself by way of hidden variables alone is derived from nothing: None, and so is all that
        needs it, as there is one rule for each.
        """
        if not any(True for _ in self._hidden_body(top)):
            return self._joined(top)
        open_: set[int] = {top}
        stack = [(top, iter(self._hidden_body(top)))]
        while stack:
            variable, rest = stack[-1]
            below = next(rest, None)
            if below is None:
                stack.pop()
                open_.discard(variable)
                cone = self._joined(variable)
                if not stack:
                    return cone
                self._hidden[variable] = cone
            elif below in open_:
                for waiting, _ in stack[1:]:
                    self._hidden[waiting] = None
                return None
            elif below not in self._hidden:
                open_.add(below)
                stack.append((below, iter(self._hidden_body(below))))
        raise AssertionError("the stack ends with its first entry")

    def _hidden_body(self, variable: int) -> Iterator[int]:
        _, body = self._definite.rule.get(variable, (0, ()))
        return (needed for needed in body if needed not in self.observed)

    def _joined(self, variable: int) -> Cone | None:
        """Return the derivation of a variable whose hidden premises are known."""
        if variable not in self._definite.rule:
            return None
        components, body = self._definite.rule[variable]
        leaves: set[int] = set()
        for needed in body:
            if needed in self.observed:
                leaves.add(needed)
                continue
            below = self._hidden[needed]
            if below is None:
                return None
            components |= below.components
            leaves |= below.leaves
        return Cone(components, frozenset(leaves))

    # --- double faults ----------------------------------------------------------------------------------

    def shown(self, fault: tuple[int, ...], rival: tuple[int, ...] = ()) -> bool:
        """Return whether something can be seen of which `fault` (one or two components) is a minimal
        diagnosis, and which `rival` does not explain.
        """
        if len(fault) == len(rival) == 1:  # most questions
            return not self.of(fault[0]) <= self.of(rival[0])
        explained = frozenset().union(*(self.of(component) for component in rival))
        if len(fault) == 1:
            return not self.of(fault[0]) <= explained
        first, second = self.of(fault[0]), self.of(fault[1])
        only_first, only_second = first - second, second - first
        unexplained = (first | second) - explained
        for one, other in product(only_first, only_second):
            if self._together((one, other)):
                if one in unexplained or other in unexplained:
                    return True
                if any(self._together((one, other, third)) for third in unexplained):
                    return True
        return False

    def _together(self, variables: tuple[int, ...]) -> bool:
        """Whether the cones of several variables are conflicts together: none is a leaf of another."""
        cones = [self.cone(variable) for variable in variables]
        return all(cone is not None and cone.leaves.isdisjoint(variables) for cone in cones)


# --- is there an observation that some faults can show, and others do not explain? Exact, for every model.
#
# "Others do not explain it" speaks of all values of what is hidden, so the question has two quantifiers:
#
#     ∃ o:  SD with F abnormal allows o   and   ∀ hidden values:  SD with G abnormal forbids o
#
# Counterexample-guided abstraction refinement answers it with two SAT solvers:
#
#     proposer: an o that F shows ──► checker: does G explain o?  no ──► found
#             ▲                             │ yes, with these hidden values h
#             └── o must break some clause ◄┘
#                 of SD under G and h
#
# What a counterexample forbids depends on G alone, so that it is kept for every further F. Hidden values
# are finitely many, so it ends; where all atoms are observed, after one refinement.
#
# Source: M. Janota, J. Marques-Silva. Abstraction-based algorithm for 2QBF. SAT 2011.

FaultSet = frozenset[int]
"""Health variables of abnormal components."""

HEALTHY: FaultSet = frozenset()


class ObservationSearch:
    """Searches observations over some variables of one model. One call at a time."""

    def __init__(self, cnf: HealthCnf, observed: Iterable[int], clock: Deadline) -> None:
        self.observed = tuple(sorted(observed))
        self._cnf = cnf
        self._count = len(cnf.components)
        self._clock = clock
        self._free = frozenset(self.observed)
        self._checker = Oracle(cnf.clauses, clock)
        # Two copies of SD that share what is observed: two faults may have to show the same.
        self._shift = cnf.variables
        copy = [[self._second(literal) for literal in clause] for clause in cnf.clauses]
        self._proposer = Oracle([*cnf.clauses, *copy], clock)
        self._top = 2 * cnf.variables
        self._guards: dict[FaultSet, int] = {}
        self._broken: dict[tuple[int, ...], int] = {}

    def find(self, showing: Sequence[FaultSet], excluding: Collection[FaultSet]) -> tuple[int, ...] | None:
        """Return an observation, as signed variables, that each fault of `showing` (at most two) can show and
        none of `excluding` explains; None: there is no such.

        Raises:
            OutOfTime: the clock ran out.
        """
        first, second = showing[0], showing[-1]
        assumptions = [
            *self._health(first),
            *(self._second(literal) for literal in self._health(second)),
            *(self._guard(fault) for fault in excluding),
        ]
        while True:
            if not self._proposer.sat(assumptions):
                return None
            model = self._proposer.model()
            seen = tuple(v if v <= len(model) and model[v - 1] > 0 else -v for v in self.observed)
            explained = False
            for fault in excluding:
                values = self._explanation(fault, seen)
                if values is not None:
                    self._refine(fault, values)
                    explained = True
            if not explained:
                return seen

    def explains(self, fault: FaultSet, seen: Sequence[int]) -> bool:
        """Return whether a fault may show an observation."""
        return self._checker.sat([*self._health(fault), *seen])

    def close(self) -> None:
        """Free the solvers."""
        self._checker.close()
        self._proposer.close()

    def _explanation(self, fault: FaultSet, seen: Sequence[int]) -> list[int] | None:
        if not self.explains(fault, seen):
            return None
        return list(self._checker.model())

    def _refine(self, fault: FaultSet, model: Sequence[int]) -> None:
        """Forbid what these hidden values explain: some clause that they leave open is broken."""
        choices = []
        for clause in self._cnf.clauses:
            rest = []
            for literal in clause:
                variable = abs(literal)
                if variable in self._free:
                    rest.append(literal)
                elif (model[variable - 1] > 0) == (literal > 0):
                    break
            else:
                choices.append(self._breaking(tuple(sorted(rest))))
        self._proposer.add([-self._guard(fault), *choices])

    def _breaking(self, rest: tuple[int, ...]) -> int:
        """Return a variable that, being true, says that none of these literals is seen."""
        found = self._broken.get(rest)
        if found is None:
            found = self._broken[rest] = self._fresh()
            for literal in rest:
                self._proposer.add([-found, -literal])
        return found

    def _guard(self, fault: FaultSet) -> int:
        found = self._guards.get(fault)
        if found is None:
            found = self._guards[fault] = self._fresh()
        return found

    def _fresh(self) -> int:
        self._top += 1
        return self._top

    def _health(self, fault: FaultSet) -> list[int]:
        return [-variable if variable in fault else variable for variable in range(1, self._count + 1)]

    def _second(self, literal: int) -> int:
        if abs(literal) in self._free:
            return literal
        return literal + self._shift if literal > 0 else literal - self._shift


Fault = tuple[int, ...]
"""Health variables of the components that are abnormal together: one, or two, ascending."""

WITNESSES = 256
"""Observations that are kept, so that one search answers for many pairs."""


class Comparison(Protocol):
    """Compares the faults of one model by what some observed variables can show."""

    def shows(self, fault: Fault) -> bool:
        """Whether the fault is detectable."""
        ...

    def told(self, fault: Fault, rival: Fault) -> bool:
        """Whether the fault can be told from the rival."""
        ...

    def always(self, fault: Fault, rival: Fault) -> bool:
        """Whether a detectable fault is told from the rival whenever it is seen. Single faults only."""
        ...

    def relevant(self, fault: Fault) -> frozenset[int]:
        """Return the atoms' variables that may tell the fault from others if they were observed, too."""
        ...

    def observing(self, more: Iterable[int]) -> Comparison:
        """Return the comparison with further variables observed."""
        ...

    def close(self) -> None:
        """Free the solvers."""
        ...


def comparison(cnf: HealthCnf, observed: Iterable[int], clock: Deadline) -> Comparison:
    """Return the comparison that suits the model."""
    definite = Definite.of(cnf)
    if definite is not None:
        return BySignatures(cnf, definite, frozenset(observed), clock)
    return BySearch(cnf, frozenset(observed), clock)


class BySignatures:
    """See robomend.diagnosis.isolability.comparing."""

    def __init__(self, cnf: HealthCnf, definite: Definite, observed: frozenset[int], clock: Deadline) -> None:
        self._cnf = cnf
        self._definite = definite
        self._clock = clock
        self._signatures = Signatures(definite, observed)

    def shows(self, fault: Fault) -> bool:
        self._clock.check()
        return self._signatures.shown(fault)

    def told(self, fault: Fault, rival: Fault) -> bool:
        self._clock.check()
        return self._signatures.shown(fault, rival)

    def always(self, fault: Fault, rival: Fault) -> bool:
        (one,), (other,) = fault, rival
        return self._signatures.of(one).isdisjoint(self._signatures.of(other))

    def relevant(self, fault: Fault) -> frozenset[int]:
        found = frozenset().union(*(self._signatures.relevant(component) for component in fault))
        return found & frozenset(self._cnf.atom_variable.values())

    def observing(self, more: Iterable[int]) -> BySignatures:
        observed = self._signatures.observed.union(more)
        return BySignatures(self._cnf, self._definite, observed, self._clock)

    def close(self) -> None:
        """There is nothing to free."""


class BySearch:
    """See robomend.diagnosis.isolability.comparing. What was found for one pair is tried on the next."""

    def __init__(self, cnf: HealthCnf, observed: frozenset[int], clock: Deadline) -> None:
        self._cnf = cnf
        self._clock = clock
        self._observed = observed
        self._search = ObservationSearch(cnf, observed, clock)
        self._seen: dict[tuple[int, ...], dict[frozenset[int], bool]] = {}

    def shows(self, fault: Fault) -> bool:
        return self._shown((fault,), _smaller(fault))

    def told(self, fault: Fault, rival: Fault) -> bool:
        return self._shown((fault,), {*_smaller(fault), frozenset(rival)})

    def always(self, fault: Fault, rival: Fault) -> bool:
        return not self._shown((fault, rival), {HEALTHY})

    def relevant(self, fault: Fault) -> frozenset[int]:
        return frozenset(self._cnf.atom_variable.values()) - self._observed

    def observing(self, more: Iterable[int]) -> BySearch:
        return BySearch(self._cnf, self._observed.union(more), self._clock)

    def close(self) -> None:
        self._search.close()

    def _shown(self, showing: tuple[Fault, ...], excluding: set[frozenset[int]]) -> bool:
        sets = [frozenset(fault) for fault in showing]
        for seen in self._seen:
            if all(self._explains(fault, seen) for fault in sets) and not any(
                self._explains(fault, seen) for fault in excluding
            ):
                return True
        found = self._search.find(sets, excluding)
        if found is None:
            return False
        if len(self._seen) < WITNESSES:
            self._seen[found] = {}
        return True

    def _explains(self, fault: frozenset[int], seen: tuple[int, ...]) -> bool:
        known = self._seen[seen]
        if fault not in known:
            known[fault] = self._search.explains(fault, seen)
        return known[fault]


def _smaller(fault: Fault) -> set[frozenset[int]]:
    """Return the proper subsets of a fault: what explains as much with less."""
    return {frozenset(some) for size in range(len(fault)) for some in combinations(fault, size)}


def pairs(components: Iterable[int]) -> Iterator[Fault]:
    """Yield the double faults of some components."""
    yield from combinations(sorted(components), 2)
