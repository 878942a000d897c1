"""What holds for good in one problem, and the join over it: the bindings that a list of guards leaves.

    (drives ?n ?h) (switchable ?h), ?n known  ──►  ?h = lidar, …    one Env for each way to satisfy them all

The guard with the fewest candidates is matched first, and again among the rest for each of its facts. An
index over (predicate, place, name) finds the candidates, so facts that do not match are never looked at.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from math import prod

from robomend.planning.domain.formulas import Is, Typed
from robomend.planning.domain.values import Domain
from robomend.planning.problem import Fact, RepairProblem

Env = dict[str, str]
"""Variables with their values."""


class Work:
    """A bound on what is computed for one question, in small steps of about a microsecond, not in time.

    Args:
        most: steps; by default there is no bound.
    """

    def __init__(self, most: float = math.inf) -> None:
        self._left = most

    def spend(self, steps: int) -> None:
        """Count what is about to be done; OutOfWork if it is more than what is left."""
        self._left -= steps
        if self._left < 0:
            raise OutOfWork


class OutOfWork(Exception):
    """There is more to do than the bound allows: no answer, and no error."""


UNBOUNDED = Work()


class StaticFacts:
    """The static facts of a problem, indexed, and its objects by type.

    Args:
        work: is spent on the facts and objects that are looked at.
    """

    def __init__(self, domain: Domain, problem: RepairProblem, work: Work = UNBOUNDED) -> None:
        self._work = work
        self._domain = domain
        self._objects = problem.objects
        self._members: dict[str, frozenset[str]] = {}
        self._index: dict[str | tuple[str, int, str], list[Fact]] = defaultdict(list)
        self.facts = frozenset(fact for fact in problem.initial if fact[0] in domain.static)
        for fact in sorted(self.facts):
            self._index[fact[0]].append(fact)
            for position, name in enumerate(fact[1:], 1):
                self._index[fact[0], position, name].append(fact)

    def members_of(self, kind: str) -> frozenset[str]:
        """Return the objects of a type and of its kinds."""
        members = self._members.get(kind)
        if members is None:
            is_a = self._domain.is_a
            members = frozenset(name for name, own in self._objects.items() if is_a(own, kind))
            self._members[kind] = members
        return members

    def most_bindings(self, variables: Typed, guards: Sequence[Is], env: Env) -> int:
        """Return a number that the bindings do not exceed, without making one of them.

        A guard has no more bindings than facts, and none of its variables more values than its type has
        objects; what no guard binds ranges over all objects of its type.
        """
        kinds = {name: kind for name, kind in variables if name not in env}
        if not kinds:
            return 1
        most = 1
        for facts, guard in sorted(
            ((len(self._candidates(guard, env)), guard) for guard in guards), key=lambda pair: pair[0]
        ):
            new = [len(self.members_of(kinds.pop(term))) for term in guard.terms if term in kinds]
            if new:
                most *= min(facts, prod(new))
        return most * prod(len(self.members_of(kind)) for kind in kinds.values())

    def bindings(self, variables: Typed, guards: Sequence[Is], env: Env) -> Iterator[Env]:
        """Yield every way to bind the variables that satisfies the static guards, extending `env`."""
        if not guards:
            yield from self._enumerate(variables, env)
            return
        best: list[Fact] = []
        chosen = -1
        for position, guard in enumerate(guards):
            candidates = self._candidates(guard, env)
            if chosen < 0 or len(candidates) < len(best):
                best, chosen = candidates, position
        terms = guards[chosen].terms
        self._work.spend(1 + len(best))
        rest = [*guards[:chosen], *guards[chosen + 1 :]]
        kinds = dict(variables)
        for fact in best:
            extended = self.unify(terms, fact[1:], env, kinds)
            if extended is not None:
                yield from self.bindings(variables, rest, extended)

    def _candidates(self, guard: Is, env: Env) -> list[Fact]:
        best = self._index.get(guard.predicate, [])
        for position, term in enumerate(guard.terms, 1):
            name = env.get(term) if term.startswith("?") else term
            if name is not None:
                found = self._index.get((guard.predicate, position, name), [])
                if len(found) < len(best):
                    best = found
        return best

    def unify(
        self, terms: Sequence[str], names: Sequence[str], env: Env, kinds: Mapping[str, str]
    ) -> Env | None:
        """Return `env` extended so that the terms become the names, each of its type; None: it cannot be."""
        extended = env
        for term, name in zip(terms, names, strict=True):
            if not term.startswith("?"):
                if term != name:
                    return None
            elif term in extended:
                if extended[term] != name:
                    return None
            else:
                if term in kinds and name not in self.members_of(kinds[term]):
                    return None
                if extended is env:
                    extended = dict(env)
                extended[term] = name
        return extended

    def _enumerate(self, variables: Typed, env: Env) -> Iterator[Env]:
        for position, (name, kind) in enumerate(variables):
            if name not in env:
                members = sorted(self.members_of(kind))
                self._work.spend(len(members))
                for member in members:
                    yield from self._enumerate(variables[position + 1 :], {**env, name: member})
                return
        yield env
