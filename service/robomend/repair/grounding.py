"""From a domain with variables to the few ground actions that a plan can use.

Grounding everything is what makes stock chains slow: 8 s at 100 components. Here the goal pulls in what it
needs:

    open goals ──► actions that achieve them ──► their preconditions ──► …      (relevance, backwards)
                   of these, what can be reached from the initial state         (deletes ignored, forwards)

Backwards, a fact is only worth achieving if it is a goal or a precondition of a relevant action, and does
not hold for good: it is false at first, or some relevant action destroys it. Dropping every other action
from a plan leaves a plan (what it needs was there and nobody left destroys it), so no plan is lost and none
gets dearer. Static facts are joined through an index, never enumerated. What holds for good disappears from
preconditions.

Facts are signed integers: +i the atom i holds, -i it does not. An action achieves the facts in its
`effects` and destroys their opposites, so negative preconditions need no special case.

Source: J. Hoffmann, B. Nebel. The FF planning system. JAIR 14, 2001, for relaxed reachability; M. Helmert.
Concise finite-domain representations for PDDL planning tasks. AIJ 173, 2009, for grounding as a join.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from robomend.errors import DomainError
from robomend.repair.domain import Domain, Effect, Schema
from robomend.repair.formulas import (
    And,
    Equal,
    Exists,
    Forall,
    Formula,
    Is,
    Not,
    Or,
    Typed,
    negation_normal,
)
from robomend.repair.policy import NODE_ACTIONS, POWER_ACTIONS
from robomend.repair.problem import Fact, RepairProblem
from robomend_client.literals import Atom, Literal

MAX_GROUND_ACTIONS = 100_000
MAX_ALTERNATIVES = 64
"""Disjunctive preconditions become one ground action for each alternative, up to this many."""

Env = dict[str, str]
Conditions = list[frozenset[int]]
"""A condition in disjunctive normal form: [] never holds, [frozenset()] always does."""

ALWAYS: Conditions = [frozenset()]


@dataclass(frozen=True, slots=True)
class GroundAction:
    """One action with its parameters filled in, over signed facts."""

    name: str
    parameters: tuple[str, ...]
    cost: float
    needs: frozenset[int]
    effects: frozenset[int]

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.parameters)})"


@dataclass(frozen=True, slots=True)
class _Guarded:
    """A quantifier: for all (or some) bindings of `variables` that satisfy the static `guards`, `rest`."""

    every: bool
    variables: Typed
    guards: tuple[Is, ...]
    rest: _Compiled


@dataclass(frozen=True, slots=True)
class _Junction:
    """All of the parts, or some."""

    every: bool
    parts: tuple[_Compiled, ...]


_Compiled = Is | Equal | Not | _Junction | _Guarded


@dataclass(frozen=True, slots=True)
class _Rule:
    """An effect with the static part of its condition as guards."""

    variables: Typed
    guards: tuple[Is, ...]
    rest: _Compiled
    atom: Is
    adds: bool


@dataclass(frozen=True, slots=True)
class _Compilation:
    """A schema, split into what is joined and what is evaluated."""

    schema: Schema
    guards: tuple[Is, ...]
    rest: _Compiled
    rules: tuple[_Rule, ...]


@lru_cache(maxsize=64)
def _compile(domain: Domain) -> tuple[_Compilation, ...]:
    def compiled(formula: Formula) -> _Compiled:
        """Expects negation normal form."""
        if isinstance(formula, And | Or):
            return _Junction(isinstance(formula, And), tuple(compiled(part) for part in formula.parts))
        if isinstance(formula, Forall):
            guards, rest = split(formula.body, negative=True)
            return _Guarded(True, formula.variables, guards, rest)
        if isinstance(formula, Exists):
            guards, rest = split(formula.body, negative=False)
            return _Guarded(False, formula.variables, guards, rest)
        return formula

    def split(formula: Formula, *, negative: bool) -> tuple[tuple[Is, ...], _Compiled]:
        """Split off static atoms: conjuncts, or for `forall` the negated disjuncts."""
        kind = Or if negative else And
        parts = formula.parts if isinstance(formula, kind) else (formula,)
        guards: list[Is] = []
        rest: list[Formula] = []
        for part in parts:
            atom = part.part if negative and isinstance(part, Not) else None if negative else part
            if isinstance(atom, Is) and atom.predicate in domain.static:
                guards.append(atom)
            else:
                rest.append(part)
        return tuple(guards), compiled(rest[0] if len(rest) == 1 else kind(tuple(rest)))

    def rule(effect: Effect) -> _Rule:
        guards, rest = split(negation_normal(effect.condition), negative=False)
        return _Rule(effect.variables, guards, rest, effect.atom, effect.adds)

    return tuple(
        _Compilation(schema, *split(_flat(negation_normal(schema.precondition)), negative=False), rules)
        for schema in domain.schemas.values()
        for rules in [tuple(rule(effect) for effect in schema.effects)]
    )


def _flat(formula: Formula) -> Formula:
    """Return a conjunction without conjunctions directly inside."""
    if not isinstance(formula, And):
        return formula
    parts: list[Formula] = []
    for part in map(_flat, formula.parts):
        parts.extend(part.parts if isinstance(part, And) else (part,))
    return And(tuple(parts))


@dataclass(frozen=True)
class GroundProblem:
    """The relevant, reachable part of a problem: actions over the facts that can change and matter."""

    actions: tuple[GroundAction, ...]
    initial: frozenset[int]
    goal: frozenset[int]
    unreachable: Mapping[int, str] = field(default_factory=dict)  # goal fact -> why, as a sentence


class Grounder:
    """The ground actions of one problem, made on demand."""

    def __init__(self, domain: Domain, problem: RepairProblem) -> None:
        self.domain = domain
        self.problem = problem
        self._compiled = _compile(domain)
        self._members: dict[str, frozenset[str]] = {}
        self._numbers: dict[Fact, int] = {}
        self._facts: list[Fact] = [()]
        self._static: set[Fact] = set()
        self._index: dict[str | tuple[str, int, str], list[Fact]] = defaultdict(list)
        self._made: dict[tuple[str, tuple[str, ...]], tuple[GroundAction, ...]] = {}
        self.refused: dict[int, str] = {}  # fact -> an action that would achieve it, and why it is refused
        self.initial: set[int] = set()  # numbers of the atoms that hold
        for fact in sorted(problem.initial):
            if fact[0] not in domain.static:
                self.initial.add(self.number(fact))
                continue
            self._static.add(fact)
            self._index[fact[0]].append(fact)
            for position, name in enumerate(fact[1:], 1):
                self._index[fact[0], position, name].append(fact)
        self._producers: dict[tuple[str, bool], list[tuple[_Compilation, _Rule]]] = defaultdict(list)
        for compilation in self._compiled:
            for rule in compilation.rules:
                self._producers[rule.atom.predicate, rule.adds].append((compilation, rule))

    # --- facts ----------------------------------------------------------------------------------

    def number(self, fact: Fact) -> int:
        """Return the positive number of an atom."""
        found = self._numbers.get(fact)
        if found is None:
            found = self._numbers[fact] = len(self._facts)
            self._facts.append(fact)
        return found

    def fact(self, number: int) -> Fact:
        """Return the atom of a signed number."""
        return self._facts[abs(number)]

    def literal(self, number: int) -> Literal:
        """Return a signed number as a literal in the model's words."""
        fact = self._facts[abs(number)]
        return Literal(Atom(fact[0], fact[1:]), number > 0)

    def holds_at_first(self, number: int) -> bool:
        """Whether a signed fact holds in the initial state."""
        return (abs(number) in self.initial) == (number > 0)

    # --- joins ----------------------------------------------------------------------------------

    def _members_of(self, kind: str) -> frozenset[str]:
        members = self._members.get(kind)
        if members is None:
            is_a, objects = self.domain.is_a, self.problem.objects
            members = frozenset(name for name, own in objects.items() if is_a(own, kind))
            self._members[kind] = members
        return members

    def _bindings(self, variables: Typed, guards: Sequence[Is], env: Env) -> Iterator[Env]:
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
        rest = [*guards[:chosen], *guards[chosen + 1 :]]
        kinds = dict(variables)
        for fact in best:
            extended = self._unify(terms, fact[1:], env, kinds)
            if extended is not None:
                yield from self._bindings(variables, rest, extended)

    def _candidates(self, guard: Is, env: Env) -> list[Fact]:
        best = self._index.get(guard.predicate, [])
        for position, term in enumerate(guard.terms, 1):
            name = env.get(term) if term.startswith("?") else term
            if name is not None:
                found = self._index.get((guard.predicate, position, name), [])
                if len(found) < len(best):
                    best = found
        return best

    def _unify(
        self, terms: Sequence[str], names: Sequence[str], env: Env, kinds: Mapping[str, str]
    ) -> Env | None:
        extended = env
        for term, name in zip(terms, names, strict=True):
            if not term.startswith("?"):
                if term != name:
                    return None
            elif term in extended:
                if extended[term] != name:
                    return None
            else:
                if term in kinds and name not in self._members_of(kinds[term]):
                    return None
                if extended is env:
                    extended = dict(env)
                extended[term] = name
        return extended

    def _enumerate(self, variables: Typed, env: Env) -> Iterator[Env]:
        for position, (name, kind) in enumerate(variables):
            if name not in env:
                for member in sorted(self._members_of(kind)):
                    yield from self._enumerate(variables[position + 1 :], {**env, name: member})
                return
        yield env

    # --- conditions -----------------------------------------------------------------------------

    def _conditions(self, formula: _Compiled, env: Env) -> Conditions:
        if isinstance(formula, Is):
            return self._atom(formula, env, 1)
        if isinstance(formula, Not):
            part = formula.part
            if isinstance(part, Equal):
                return [] if self._same(part, env) else ALWAYS
            assert isinstance(part, Is)  # negation normal form
            return self._atom(part, env, -1)
        if isinstance(formula, Equal):
            return ALWAYS if self._same(formula, env) else []
        if isinstance(formula, _Junction):
            parts = (self._conditions(part, env) for part in formula.parts)
        else:
            parts = (
                self._conditions(formula.rest, binding)
                for binding in self._bindings(formula.variables, formula.guards, env)
            )
        return self._all(parts) if formula.every else self._any(parts)

    def _atom(self, atom: Is, env: Env, sign: int) -> Conditions:
        fact = (atom.predicate, *(env.get(term, term) for term in atom.terms))
        if atom.predicate in self.domain.static:
            return ALWAYS if (fact in self._static) == (sign > 0) else []
        return [frozenset((sign * self.number(fact),))]

    @staticmethod
    def _same(equal: Equal, env: Env) -> bool:
        return env.get(equal.left, equal.left) == env.get(equal.right, equal.right)

    def _all(self, parts: Iterable[Conditions]) -> Conditions:
        result = ALWAYS
        for part in parts:
            if not part:
                return []
            if part is ALWAYS:
                continue
            if len(result) == 1 and len(part) == 1:
                result = [result[0] | part[0]]
            else:
                result = list(dict.fromkeys(one | other for one in result for other in part))
                self._limit(result)
        if len(result) > 1 or result is not ALWAYS:
            result = [one for one in result if not any(-number in one for number in one)]
        return result

    def _any(self, parts: Iterable[Conditions]) -> Conditions:
        result: dict[frozenset[int], None] = {}
        for part in parts:
            if part is ALWAYS:
                return ALWAYS
            result.update(dict.fromkeys(part))
            self._limit(result)
        return list(result)

    @staticmethod
    def _limit(found: Sequence[object] | Mapping[frozenset[int], None]) -> None:
        if len(found) > MAX_ALTERNATIVES:
            raise DomainError(
                f"a precondition has more than {MAX_ALTERNATIVES} alternatives; split the action"
            )

    # --- actions --------------------------------------------------------------------------------

    def instances(self, name: str, parameters: tuple[str, ...]) -> tuple[GroundAction, ...]:
        """Return a ground action: none if its static conditions fail, several for a disjunction."""
        for compilation in self._compiled:
            if compilation.schema.name == name and len(compilation.schema.parameters) == len(parameters):
                return self._instances(compilation, parameters)
        return ()

    def _instances(self, compilation: _Compilation, parameters: tuple[str, ...]) -> tuple[GroundAction, ...]:
        schema = compilation.schema
        key = (schema.name, parameters)
        if key in self._made:
            return self._made[key]
        if len(self._made) >= MAX_GROUND_ACTIONS:
            raise DomainError(
                f"more than {MAX_GROUND_ACTIONS} ground actions; guard the parameters of {schema.name!r} "
                "with static predicates",
                schema.file,
                schema.line,
            )
        env = {variable: value for (variable, _), value in zip(schema.parameters, parameters, strict=True)}
        found: tuple[GroundAction, ...] = ()
        typed = all(
            value in self._members_of(kind)
            for (_, kind), value in zip(schema.parameters, parameters, strict=True)
        )
        if typed and all(self._atom(guard, env, 1) for guard in compilation.guards):
            effects = self._effects(compilation, env)
            cost = schema.cost * self._factor(parameters)
            found = tuple(
                GroundAction(schema.name, parameters, cost, needs, effects)
                for needs in self._conditions(compilation.rest, env)
            )
        self._made[key] = found
        return found

    def _effects(self, compilation: _Compilation, env: Env) -> frozenset[int]:
        """PDDL deletes first and then adds, so what is added and deleted is added."""
        adds: set[int] = set()
        deletes: set[int] = set()
        for rule in compilation.rules:
            for binding in self._bindings(rule.variables, rule.guards, env):
                if self._conditions(rule.rest, binding):
                    fact = (rule.atom.predicate, *(binding.get(term, term) for term in rule.atom.terms))
                    (adds if rule.adds else deletes).add(self.number(fact))
        return frozenset(adds | {-number for number in deletes - adds})

    def _factor(self, parameters: tuple[str, ...]) -> float:
        """An action costs as its first component says."""
        for name in parameters:
            if name in self.problem.components:
                return self.problem.costs.get(name, 1.0)
        return 1.0

    def achievers(self, number: int) -> list[GroundAction]:
        """Return the ground actions that achieve a signed fact and are not refused, in a fixed order."""
        fact = self.fact(number)
        found: dict[int, GroundAction] = {}
        for compilation, rule in self._producers.get((fact[0], number > 0), ()):
            variables = compilation.schema.parameters + rule.variables
            env = self._unify(rule.atom.terms, fact[1:], {}, dict(variables))
            if env is None:
                continue
            guards = compilation.guards + rule.guards
            for binding in self._bindings(variables, guards, env):
                parameters = tuple(binding[name] for name, _ in compilation.schema.parameters)
                for action in self._instances(compilation, parameters):
                    if number not in action.effects:
                        continue
                    if (why := self.refusal(action)) is not None:
                        self.refused.setdefault(number, f"{action} is refused: {why}")
                    else:
                        found[id(action)] = action
        return list(found.values())

    def refusal(self, action: GroundAction) -> str | None:
        """Return why an action may not be taken, or None: it takes power or process from a protected
        component, changes one that is set aside, or was tried in vain.
        """
        problem = self.problem
        if problem.avoided and str(action) in problem.avoided:
            return "it was tried, and it did not help"
        for number in sorted(action.effects):
            fact = self.fact(number)
            if len(fact) != 2:
                continue
            predicate, name = fact
            if name in problem.protected and (
                (number > 0 and predicate in TAKING) or (number < 0 and predicate in GIVING)
            ):
                saved = problem.protected[name]
                return f"{saved} is protected" if saved == name else f"{saved}, which it feeds, is protected"
            if name in problem.excluded and predicate in TAKING | GIVING:
                if name in problem.idle and action.name not in OWN_ACTIONS:
                    continue
                return f"{name} is left alone"
        return None


GIVING = frozenset({"on", "running"})
OWN_ACTIONS = POWER_ACTIONS | NODE_ACTIONS
TAKING = frozenset({"off", "stopped", "not_on", "not_running"})
