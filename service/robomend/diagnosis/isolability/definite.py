"""Fault signatures of a definite system description: exact, and as fast as reading the model.

The six schemes give rules `healthy components and atoms -> atom`, with one rule for each atom. Then an atom
is derived in one way only, and the observed ones cut its derivation:

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

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

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
