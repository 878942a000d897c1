"""Check a plan by carrying it out in the domain's own semantics.

Two checks that share no code with the planners:

    replay      over the ground actions and the whole state; every plan goes through it before it is shown
    validate    over the formulas of the domain as written, with quantifiers evaluated object by object: it
                knows nothing of grounding, relevance or parts, hence it is the oracle of their tests

Both name the first action that fails and the precondition that it fails at.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

from robomend.planning.domain.formulas import (
    Conjunction,
    Disjunction,
    Equal,
    Exists,
    Forall,
    Formula,
    Is,
    Negation,
    Typed,
)
from robomend.planning.domain.values import Domain
from robomend.planning.grounding import GroundAction, Grounder
from robomend.planning.problem import Fact, RepairProblem

Named = tuple[str, tuple[str, ...]]
"""An action by name and parameters."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """Why a plan is none."""

    position: int | None  # of the action in the plan; None: it ran through and misses the goal
    action: str
    condition: str

    def __str__(self) -> str:
        if self.position is None:
            return f"after the last action {self.condition} does not hold, which is a goal"
        return f"step {self.position}, {self.action}: {self.condition} does not hold before it"


def replay(
    grounder: Grounder, plan: Sequence[Named], goal: Iterable[int]
) -> tuple[list[GroundAction], Flaw | None]:
    """Carry out a plan over ground facts.

    Returns:
        The complete ground actions, nothing left out as irrelevant, and the first flaw if there is one.
    """
    state = set(grounder.initial)
    done: list[GroundAction] = []
    for position, (name, parameters) in enumerate(plan):
        text = f"{name}({', '.join(parameters)})"
        choices = grounder.instances(name, parameters)
        if not choices:
            return done, Flaw(position, text, "a static precondition")
        failing: int | None = None
        for action in choices:
            failing = next((n for n in sorted(action.needs, key=abs) if (abs(n) in state) != (n > 0)), None)
            if failing is None:
                break
        if failing is not None:
            return done, Flaw(position, text, str(grounder.literal(failing)))
        if (why := grounder.refusal(action)) is not None:
            return done, Flaw(position, text, f"permission: {why}")
        state.difference_update(-number for number in action.effects if number < 0)
        state.update(number for number in action.effects if number > 0)
        done.append(action)
    missing = next((number for number in goal if (abs(number) in state) != (number > 0)), None)
    if missing is not None:
        return done, Flaw(None, "", str(grounder.literal(missing)))
    return done, None


def validate(
    domain: Domain, problem: RepairProblem, plan: Sequence[Named], goal: Iterable[Fact]
) -> Flaw | None:
    """Carry out a plan over the domain as written; None: it is valid."""
    state = set(problem.initial)
    world = _World(domain, problem)
    for position, (name, parameters) in enumerate(plan):
        text = f"{name}({', '.join(parameters)})"
        name, parameters = problem.as_pddl(name, parameters)
        schema = domain.schemas[name]
        for (variable, kind), value in zip(schema.parameters, parameters, strict=True):
            if not domain.is_a(problem.objects[value], kind):
                return Flaw(position, text, f"{variable} being a {kind}")
        env = {variable: value for (variable, _), value in zip(schema.parameters, parameters, strict=True)}
        failing = world.failing(schema.precondition, env, state)
        if failing is not None:
            return Flaw(position, text, failing)
        adds: set[Fact] = set()
        deletes: set[Fact] = set()
        for effect in schema.effects:
            for binding in world.every(effect.variables, env):
                if world.true(effect.condition, binding, state):
                    (adds if effect.adds else deletes).add(world.fact(effect.atom, binding))
        state = (state - deletes) | adds
    for wanted in goal:
        if wanted not in state:
            return Flaw(None, "", f"{wanted[0]}({','.join(wanted[1:])})")
    return None


class _World:
    def __init__(self, domain: Domain, problem: RepairProblem) -> None:
        self._domain = domain
        self._objects = problem.objects

    def every(self, variables: Typed, env: dict[str, str]) -> Iterable[dict[str, str]]:
        kinds = [
            [name for name, own in self._objects.items() if self._domain.is_a(own, kind)]
            for _, kind in variables
        ]
        for values in product(*kinds):
            yield {**env, **{variable: value for (variable, _), value in zip(variables, values, strict=True)}}

    @staticmethod
    def fact(atom: Is, env: dict[str, str]) -> Fact:
        return (atom.predicate, *(env.get(term, term) for term in atom.terms))

    def true(self, formula: Formula, env: dict[str, str], state: set[Fact]) -> bool:
        if isinstance(formula, Is):
            return self.fact(formula, env) in state
        if isinstance(formula, Equal):
            return env.get(formula.left, formula.left) == env.get(formula.right, formula.right)
        if isinstance(formula, Negation):
            return not self.true(formula.part, env, state)
        if isinstance(formula, Conjunction):
            return all(self.true(part, env, state) for part in formula.parts)
        if isinstance(formula, Disjunction):
            return any(self.true(part, env, state) for part in formula.parts)
        results = (self.true(formula.body, binding, state) for binding in self.every(formula.variables, env))
        return all(results) if isinstance(formula, Forall) else any(results)

    def failing(self, formula: Formula, env: dict[str, str], state: set[Fact]) -> str | None:
        """Return the smallest part of a condition that does not hold, as text; None if it all holds."""
        if self.true(formula, env, state):
            return None
        if isinstance(formula, Conjunction):
            return next(
                text for part in formula.parts if (text := self.failing(part, env, state)) is not None
            )
        if isinstance(formula, Forall):
            return next(
                text
                for binding in self.every(formula.variables, env)
                if (text := self.failing(formula.body, binding, state)) is not None
            )
        if isinstance(formula, Disjunction) and formula.parts:
            return self.failing(formula.parts[-1], env, state)
        if isinstance(formula, Negation) and isinstance(formula.part, Is):
            fact = self.fact(formula.part, env)
            return f"not {fact[0]}({','.join(fact[1:])})"
        if isinstance(formula, Is):
            fact = self.fact(formula, env)
            return f"{fact[0]}({','.join(fact[1:])})"
        return "exists" if isinstance(formula, Exists) else "a condition"
