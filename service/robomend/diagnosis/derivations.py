"""All minimal conflicts of a robot at once, by backward chaining: no solver, no search.

The clauses of a component model are Horn, health occurs in them as a premise only, and observations are
facts:

    ¬AB(n) ∧ ok(a) ∧ ok(b) → ok(t)        definite: n healthy, a and b ok, so t is ok
    ok(t) seen not ok                     a goal: whatever derives ok(t) is a conflict

A set of components conflicts with OBS exactly if their being healthy derives something that was seen to be
otherwise (or a rule without conclusion). So each literal that was seen to fail is asked for its derivations,
and these for theirs, until they rest on observations:

    not ok(t) ◄── n, ok(a), ok(b)      ok(a) was seen: a premise
                             ok(b) ◄── m, …      ok(b) was not: whatever derives it
                     an atom that was seen to fail derives nothing: deriving it is a smaller conflict

A derivation is told by the set of components that it takes to be healthy, its *environment*; only minimal
ones are kept. An atom that was not seen mostly has one, so that the work is in proportion to what is behind
the failures, not to the model. Two publishers a topic in a row of k topics have 2^k environments, though:
past a bound the caller asks the solver for conflicts one by one instead.

Sources:
    J. de Kleer. An assumption-based TMS. AIJ 28(2), 1986 (environments and labels).
    W. Dowling, J. Gallier. Linear-time algorithms for testing the satisfiability of propositional Horn
    formulae. JLP 1(3), 1984.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from robomend.diagnosis.masks import mask_of
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs, Supposed
from robomend.model.cnf import HealthCnf

MAX_ENVIRONMENTS = 5_000
"""Of all atoms together, beyond one an atom."""

CHECK_EVERY = 256
"""Atoms between two looks at the clock."""


class TooManyEnvironments(Exception):
    """The conflicts are too many to be listed beforehand."""


class Derivation(NamedTuple):
    """How an atom, or a contradiction, is derived: its environment and its last step.

    Of a conflict: how what was seen to fail, or a contradiction, is derived.
    """

    mask: int  # the environment: components whose health it takes
    origin: int  # of the last rule: index into cnf.rules
    head: int  # what that rule derives; 0: a contradiction
    premises: tuple[int, ...]  # atoms of its body that were seen to hold …
    before: tuple[Derivation, ...]  # … and how the others are derived

    def steps(self) -> list[Derivation]:
        """Return all steps, the last one first."""
        if not self.before:
            return [self]
        found: dict[int, Derivation] = {}
        todo = [self]
        while todo:
            step = todo.pop()
            if id(step) not in found:
                found[id(step)] = step
                todo.extend(reversed(step.before))
        return list(found.values())


class HornRule(NamedTuple):
    """A clause: the health of these components and the body derive the head."""

    mask: int
    body: tuple[int, ...]
    opposite: tuple[int, ...]  # of the body: one of these seen, and the rule says nothing
    head: int  # 0: none, they contradict one another
    origin: int
    alone: Derivation  # of the head, where all of the body is seen


class Derivations:
    """The rules of one model, by what they conclude."""

    def __init__(self, cnf: HealthCnf) -> None:
        n = len(cnf.components)
        self._rules: dict[int, list[HornRule]] = {}
        self._goals: list[HornRule] = []  # rules without conclusion
        for clause, origin in zip(cnf.clauses, cnf.origins, strict=True):
            head = next((literal for literal in clause if literal > 0), 0)
            mask = mask_of(-literal for literal in clause if -n <= literal < 0)
            body = tuple(-literal for literal in clause if literal < -n)
            alone = Derivation(mask, origin, head, body, ())
            rule = HornRule(mask, body, tuple(-atom for atom in body), head, origin, alone)
            (self._rules.setdefault(head, []) if head else self._goals).append(rule)

    @staticmethod
    def suit(cnf: HealthCnf) -> bool:
        """Return whether the clauses are Horn and health is a premise only."""
        n = len(cnf.components)
        return (
            not cnf.modes
            and not cnf.circuit
            and all(
                sum(literal > 0 for literal in clause) < 2 and not any(0 < literal <= n for literal in clause)
                for clause in cnf.clauses
            )
        )

    def conflicts(
        self, observed: SignedObs, supposed: Supposed, check: Callable[[], None]
    ) -> list[Derivation]:
        """Return conflicts among which are all minimal ones; those supposed healthy are not in their masks.

        Args:
            check: called now and then; may raise to end the work.

        Raises:
            TooManyEnvironments: see the module.
        """
        seen = observed.seen
        rules_of = self._rules.get
        rules = self._goals.copy()
        for number in observed.failed:
            rules += rules_of(-number, ())
        found: list[Derivation] = []
        asked: _Asked | None = None  # mostly what was seen is all that a rule needs
        plain = supposed is NOTHING_SUPPOSED
        for rule in rules:
            if plain and seen.issuperset(rule.body):
                found.append(rule.alone)
            elif seen.isdisjoint(rule.opposite):
                if asked is None:
                    asked = _Asked(self._rules, seen, supposed, check)
                found += asked.derivations(rule)
        return found

    def may_spare(self, mask: int, steps: Iterable[Derivation]) -> bool:
        """Return whether a derivation may rest on more than it must.

        It does not where its components' health has no other rule for what it derives, for what it takes as
        seen, and for a contradiction.
        """
        rules, others = self._rules, ~mask
        goals = len([rule for rule in self._goals if not rule.mask & others])
        for step in steps:
            if step.head:
                concluding = rules[step.head]
                if len(concluding) > 1 and len([rule for rule in concluding if not rule.mask & others]) > 1:
                    return True
            else:
                goals -= 1
            for atom in step.premises:
                for rule in rules.get(atom, ()):
                    if not rule.mask & others:
                        return True
        return goals > 0


class Applied(NamedTuple):
    """A rule under the observations: what it still needs."""

    mask: int  # less those supposed healthy
    premises: tuple[int, ...]  # of its body, what was seen …
    unseen: tuple[int, ...]  # … and what was not
    head: int
    origin: int


class _Asked:
    """One question: the derivations of the atoms that were not seen, found as they are needed."""

    def __init__(
        self,
        rules: dict[int, list[HornRule]],
        seen: frozenset[int],
        supposed: Supposed,
        check: Callable[[], None],
    ) -> None:
        self._rules = rules
        self._seen = seen
        self._healthy = ~mask_of(supposed.healthy)
        self._abnormal = mask_of(supposed.abnormal)
        self._check = check
        self._labels: dict[int, list[Derivation]] = {}
        self._left = MAX_ENVIRONMENTS

    def derivations(self, rule: HornRule) -> list[Derivation]:
        """Return how a rule that is not silent derives what it concludes, for each minimal environment."""
        if rule.mask & self._abnormal:
            return []
        applied = self._applied(rule)
        for atom in applied.unseen:
            if atom not in self._labels:
                self._derive(atom)
        return self._joined(applied)

    def _applied(self, rule: HornRule) -> Applied:
        """Return what the rule still needs."""
        mask, body, _, head, origin, _ = rule
        seen = self._seen
        unseen = tuple([atom for atom in body if atom not in seen])
        if unseen:
            body = tuple([atom for atom in body if atom in seen]) if len(unseen) < len(body) else ()
        return Applied(mask & self._healthy, body, unseen, head, origin)

    def _usable(self, atom: int) -> list[Applied]:
        """Return the rules that may derive an atom."""
        seen, abnormal = self._seen, self._abnormal
        return [
            self._applied(rule)
            for rule in self._rules.get(atom, ())
            if not rule.mask & abnormal and seen.isdisjoint(rule.opposite)
        ]

    def _label(self, usable: list[Applied]) -> list[Derivation]:
        """Return the derivations by these rules with minimal environments."""
        found = [derivation for one in usable for derivation in self._joined(one)]
        return self._minimal(found) if len(found) > 1 else found

    def _derive(self, start: int) -> None:
        """Label an atom and all that it may be derived from.

        In post-order one pass is enough, unless atoms derive one another; then passes go on until nothing
        changes. Labels only grow better, so that this ends.
        """
        rules = self._usable(start)
        if not any(one.unseen for one in rules):  # mostly it rests on what was seen
            self._labels[start] = self._label(rules)
            return
        order: list[int] = []
        usable: dict[int, list[Applied]] = {}
        circular = False
        open_: set[int] = set()
        todo = [start]
        while todo:
            atom = todo[-1]
            if atom not in usable and atom not in self._labels:
                if len(usable) % CHECK_EVERY == 0:
                    self._check()
                open_.add(atom)
                usable[atom] = self._usable(atom)
                for one in usable[atom]:
                    for other in one.unseen:
                        if other in open_:
                            circular = True
                        elif other not in self._labels and other not in usable:
                            todo.append(other)
                continue
            todo.pop()
            if atom in open_:
                open_.discard(atom)
                order.append(atom)
        labels = self._labels
        for atom in order:
            labels[atom] = []
        changed = True
        while changed:
            changed = False
            for position, atom in enumerate(order):
                if position % CHECK_EVERY == 0:
                    self._check()
                found = self._label(usable[atom])
                if not circular:
                    labels[atom] = found
                elif {one.mask for one in found} != {one.mask for one in labels[atom]}:
                    labels[atom] = found
                    changed = True

    def _joined(self, applied: Applied) -> list[Derivation]:
        """Return what a rule derives whose unseen premises are labelled: one of each, joined."""
        mask, premises, unseen, head, origin = applied
        if not unseen:
            return [Derivation(mask, origin, head, premises, ())]
        joined: list[tuple[int, tuple[Derivation, ...]]] = [(mask, ())]
        for atom in unseen:
            label = self._labels[atom]
            joined = [(mask | one.mask, (*before, one)) for mask, before in joined for one in label]
            self._left -= max(0, len(joined) - 1)
            if self._left < 0:
                raise TooManyEnvironments
        return [Derivation(mask, origin, head, premises, before) for mask, before in joined]

    def _minimal(self, found: list[Derivation]) -> list[Derivation]:
        self._left -= len(found) - 1
        if self._left < 0:
            raise TooManyEnvironments
        found.sort(key=lambda one: one.mask.bit_count())
        kept: list[Derivation] = []
        for one in found:
            if not any(smaller.mask & one.mask == smaller.mask for smaller in kept):
                kept.append(one)
        return kept
