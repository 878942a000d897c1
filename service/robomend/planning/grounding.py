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
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass, field

from robomend.errors import DomainError
from robomend.planning.domain.compilation import (
    Compilation,
    Condition,
    GuardedEffect,
    Junction,
    compile_domain,
)
from robomend.planning.domain.formulas import Equal, Is, Negation, Typed
from robomend.planning.domain.values import Domain, Schema
from robomend.planning.policy import DARK, NODE_ACTIONS, POWER_ACTIONS
from robomend.planning.prediction import OBSERVED_FACTS
from robomend.planning.problem import MEND, Fact, RepairProblem
from robomend.planning.static_facts import UNBOUNDED, Env, StaticFacts, Work
from robomend_client.literals import Atom, Literal

MAX_GROUND_ACTIONS = 100_000

MAX_BINDINGS = 1_000_000
"""Of the variables of one action or quantifier, by its static guards: counted before one is made."""

MAX_STEPS = 10_000_000
"""Bindings of a whole problem: a minute. Whoever plans ends it earlier, by the clock."""

MAX_ALTERNATIVES = 64
"""Disjunctive preconditions become one ground action for each alternative, up to this many."""

Alternatives = list[frozenset[int]]
"""A condition in disjunctive normal form: [] never holds, [frozenset()] always does."""

ALWAYS: Alternatives = [frozenset()]

OWN_ACTIONS = POWER_ACTIONS | NODE_ACTIONS


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


@dataclass(frozen=True)
class GroundProblem:
    """The relevant, reachable part of a problem: actions over the facts that can change and matter."""

    actions: tuple[GroundAction, ...]
    initial: frozenset[int]
    goal: frozenset[int]
    unreachable: Mapping[int, str] = field(default_factory=dict)  # goal fact -> why, as a sentence


class Grounder:
    """The ground actions of one problem, made on demand."""

    def __init__(self, domain: Domain, problem: RepairProblem, work: Work = UNBOUNDED) -> None:
        self._schema: Schema | None = None  # of the action that is being ground, for errors
        self.domain = domain
        self.problem = problem
        self._numbers: dict[Fact, int] = {}
        self._facts: list[Fact] = [()]
        self._static = StaticFacts(domain, problem, work)
        members = self._static.members_of  # an action on what there is none of, such as remedies, is left out
        self._compiled = [
            one for one in compile_domain(domain) if all(members(kind) for _, kind in one.schema.parameters)
        ]
        self._made: dict[tuple[str, tuple[str, ...]], tuple[GroundAction, ...]] = {}
        self._steps = 0
        self.refused: dict[int, str] = {}  # fact -> an action that would achieve it, and why it is refused
        self.initial: set[int] = set()  # numbers of the atoms that hold
        for fact in sorted(problem.initial - self._static.facts):
            self.initial.add(self.number(fact))
        self._producers: dict[tuple[str, bool], list[tuple[Compilation, GuardedEffect]]] = defaultdict(list)
        for compilation in self._compiled:
            for effect in compilation.effects:
                self._producers[effect.atom.predicate, effect.adds].append((compilation, effect))

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

    # --- conditions -----------------------------------------------------------------------------

    def _alternatives(self, formula: Condition, env: Env) -> Alternatives:
        """Return what must hold of the facts that can change for a condition to hold."""
        if isinstance(formula, Is):
            return self._atom(formula, env, 1)
        if isinstance(formula, Negation):
            part = formula.part
            if isinstance(part, Equal):
                return [] if self._same(part, env) else ALWAYS
            assert isinstance(part, Is)  # negation normal form
            return self._atom(part, env, -1)
        if isinstance(formula, Equal):
            return ALWAYS if self._same(formula, env) else []
        if isinstance(formula, Junction):
            parts = (self._alternatives(part, env) for part in formula.parts)
        else:
            parts = (
                self._alternatives(formula.rest, binding)
                for binding in self._bindings(formula.variables, formula.guards, env)
            )
        return self._all(parts) if formula.every else self._any(parts)

    def _atom(self, atom: Is, env: Env, sign: int) -> Alternatives:
        fact = (atom.predicate, *(env.get(term, term) for term in atom.terms))
        if atom.predicate in self.domain.static:
            return ALWAYS if (fact in self._static.facts) == (sign > 0) else []
        return [frozenset((sign * self.number(fact),))]

    @staticmethod
    def _same(equal: Equal, env: Env) -> bool:
        return env.get(equal.left, equal.left) == env.get(equal.right, equal.right)

    def _all(self, parts: Iterable[Alternatives]) -> Alternatives:
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

    def _any(self, parts: Iterable[Alternatives]) -> Alternatives:
        result: dict[frozenset[int], None] = {}
        for part in parts:
            if part is ALWAYS:
                return ALWAYS
            result.update(dict.fromkeys(part))
            self._limit(result)
        return list(result)

    @staticmethod
    def _limit(found: Sized) -> None:
        if len(found) > MAX_ALTERNATIVES:
            raise DomainError(
                f"a precondition has more than {MAX_ALTERNATIVES} alternatives; split the action"
            )

    def _bindings(self, variables: Typed, guards: Sequence[Is], env: Env) -> Iterator[Env]:
        """Yield the bindings that the static guards leave.

        Raises:
            DomainError: there may be too many, or with these there are.
        """
        most = self._static.most_bindings(variables, guards, env)
        if most > MAX_BINDINGS:
            raise self._too_many(f"has variables with up to {most:,} bindings; at most {MAX_BINDINGS:,}")
        for binding in self._static.bindings(variables, guards, env):
            self._steps += 1
            if self._steps > MAX_STEPS:
                raise self._too_many(f"is ground when {MAX_STEPS:,} bindings were made; no more")
            yield binding

    def _too_many(self, what: str) -> DomainError:
        schema = self._schema
        name, file, line = ("", None, None) if schema is None else (schema.name, schema.file, schema.line)
        remedy = "guard the variables with static predicates, or use fewer"
        return DomainError(f"action {name!r} {what} are tried: {remedy}", file, line)

    # --- actions --------------------------------------------------------------------------------

    def instances(self, name: str, parameters: tuple[str, ...]) -> tuple[GroundAction, ...]:
        """Return a ground action: none if its static conditions fail, several for a disjunction."""
        name, parameters = self.problem.as_pddl(name, parameters)
        for compilation in self._compiled:
            if compilation.schema.name == name and len(compilation.schema.parameters) == len(parameters):
                return self._instances(compilation, parameters)
        return ()

    def _instances(self, compilation: Compilation, parameters: tuple[str, ...]) -> tuple[GroundAction, ...]:
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
        self._schema = schema
        env = {variable: value for (variable, _), value in zip(schema.parameters, parameters, strict=True)}
        found: tuple[GroundAction, ...] = ()
        typed = all(
            value in self._static.members_of(kind)
            for (_, kind), value in zip(schema.parameters, parameters, strict=True)
        )
        if typed and all(self._atom(guard, env, 1) for guard in compilation.guards):
            effects = self._effects(compilation, env)
            cost = schema.cost * self._factor(parameters)
            act = schema.name, parameters
            if schema.name == MEND:
                act = self.problem.acts.get(parameters[0], act)
            found = tuple(
                GroundAction(*act, cost, needs, effects)
                for needs in self._alternatives(compilation.rest, env)
            )
        self._made[key] = found
        return found

    def _effects(self, compilation: Compilation, env: Env) -> frozenset[int]:
        """PDDL deletes first and then adds, so what is added and deleted is added."""
        adds: set[int] = set()
        deletes: set[int] = set()
        for effect in compilation.effects:
            for binding in self._bindings(effect.variables, effect.guards, env):
                if self._alternatives(effect.rest, binding):
                    fact = (effect.atom.predicate, *(binding.get(term, term) for term in effect.atom.terms))
                    (adds if effect.adds else deletes).add(self.number(fact))
        return frozenset(adds | {-number for number in deletes - adds})

    def _factor(self, parameters: tuple[str, ...]) -> float:
        """An action costs as its first component says."""
        for name in parameters:
            if name in self.problem.components or name in self.problem.acts:
                return self.problem.costs.get(name, 1.0)
        return 1.0

    def every_action(self) -> Iterator[GroundAction]:
        """Yield all ground actions that are not refused, whether a plan can use them or not."""
        for compilation in self._compiled:
            variables = compilation.schema.parameters
            self._schema = compilation.schema
            for binding in self._bindings(variables, compilation.guards, {}):
                for action in self._instances(compilation, tuple(binding[name] for name, _ in variables)):
                    if self.refusal(action) is None:
                        yield action

    def achievers(self, number: int) -> list[GroundAction]:
        """Return the ground actions that achieve a signed fact and are not refused, in a fixed order."""
        fact = self.fact(number)
        found: dict[int, GroundAction] = {}
        for compilation, effect in self._producers.get((fact[0], number > 0), ()):
            variables = compilation.schema.parameters + effect.variables
            env = self._static.unify(effect.atom.terms, fact[1:], {}, dict(variables))
            if env is None:
                continue
            guards = compilation.guards + effect.guards
            self._schema = compilation.schema
            for binding in self._bindings(variables, guards, env):
                parameters = tuple(binding[name] for name, _ in compilation.schema.parameters)
                for action in self._instances(compilation, parameters):
                    if number not in action.effects:
                        continue
                    if (why := self.refusal(action)) is not None:
                        self.refused.setdefault(number, self._told(action, why))
                    else:
                        found[id(action)] = action
        return list(found.values())

    def _told(self, action: GroundAction, why: str) -> str:
        """Return the sentence of an action that is refused, as what a person must do where only one can."""
        offers = self.problem.offers
        if offers is None or offers.by_hand.get(action.name) != why:
            return f"{action} is refused: {why}"
        name = action.parameters[0]
        what = "power-cycle" if ("on", name) in self.problem.initial else "switch on"
        return f"a person must {what} {name}: {why}"

    def _left_broken(self, node: str, action: GroundAction) -> bool:
        """Whether the node must restart after what the action restarts, or resets.

        What comes on was off, and its driver broken already.
        """
        initial = self.problem.initial
        if any(("tied", node, other) in initial for other in action.parameters):
            return True
        gained = (number for number in action.effects if number > 0)
        comes_on = any(self.fact(number)[0] == "on" for number in gained)
        return not comes_on and any(fact[:2] == ("drives", node) for fact in initial)

    def refusal(self, action: GroundAction) -> str | None:
        """Return why an action may not be taken, or None: it takes power or process from a protected
        component, or breaks one that would have to restart after it, changes one that is set aside, is to be
        avoided, or nobody offers to do it.
        """
        problem = self.problem
        if problem.avoided and (why := problem.avoided.get(str(action))) is not None:
            return why
        if problem.forbidden and (why := problem.forbidden.get(action.name)) is not None:
            return why
        if problem.offers is not None:
            nobody = problem.offers.why_nobody(action.name, action.parameters)
            if nobody is not None:
                return nobody
        for number in sorted(action.effects):
            fact = self.fact(number)
            if len(fact) != 2:
                continue
            predicate, name = fact
            if name in problem.protected and (
                (number > 0 and predicate in DARK)
                or (number < 0 and predicate in OBSERVED_FACTS)
                or (number > 0 and predicate == "bad" and self._left_broken(name, action))
                or (number > 0 and predicate in OBSERVED_FACTS and str(action) in problem.acts)  # restarts it
            ):
                return problem.protected[name]
            if name in problem.excluded and predicate in DARK | OBSERVED_FACTS:
                if name in problem.idle and action.name not in OWN_ACTIONS:
                    continue
                return f"{name} is left alone"
        return None
