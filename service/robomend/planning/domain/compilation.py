"""A domain's actions, made ready for grounding: static atoms apart from what has to be evaluated.

    precondition ──► negation normal form ──► guards: static atoms, joined through an index
                                          └─► rest: evaluated for every binding that the guards leave

The same for the condition of each effect and the body of each quantifier. `exists ?x (g and r)` goes through
the bindings of ?x that satisfy the static g and asks for r in one of them; `forall ?x (not g or r)` goes
through the same bindings and asks for r in all, hence the guards of a `forall` are its negated disjuncts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

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
    negation_normal,
)
from robomend.planning.domain.values import Domain, Effect, Schema


@dataclass(frozen=True, slots=True)
class Guarded:
    """A quantifier: for all (or some) bindings of `variables` that satisfy the static `guards`, `rest`."""

    every: bool
    variables: Typed
    guards: tuple[Is, ...]
    rest: Condition


@dataclass(frozen=True, slots=True)
class Junction:
    """All of the parts, or some."""

    every: bool
    parts: tuple[Condition, ...]


Condition = Is | Equal | Negation | Junction | Guarded


@dataclass(frozen=True, slots=True)
class GuardedEffect:
    """An effect with the static part of its condition as guards."""

    variables: Typed
    guards: tuple[Is, ...]
    rest: Condition
    atom: Is
    adds: bool


@dataclass(frozen=True, slots=True)
class Compilation:
    """A schema, split into what is joined and what is evaluated."""

    schema: Schema
    guards: tuple[Is, ...]
    rest: Condition
    effects: tuple[GuardedEffect, ...]


@lru_cache(maxsize=64)
def compile_domain(domain: Domain) -> tuple[Compilation, ...]:
    """Return every action of the domain, in its order; done once for a domain."""
    return tuple(_compilation(schema, domain.static) for schema in domain.schemas.values())


def _compilation(schema: Schema, static: frozenset[str]) -> Compilation:
    guards, rest = _guarded(_flat(negation_normal(schema.precondition)), static)
    return Compilation(schema, guards, rest, tuple(_effect(one, static) for one in schema.effects))


def _effect(effect: Effect, static: frozenset[str]) -> GuardedEffect:
    guards, rest = _guarded(negation_normal(effect.condition), static)
    return GuardedEffect(effect.variables, guards, rest, effect.atom, effect.adds)


def _condition(formula: Formula, static: frozenset[str]) -> Condition:
    """Return a formula in negation normal form with the guards of its quantifiers split off."""
    if isinstance(formula, Conjunction | Disjunction):
        return Junction(
            isinstance(formula, Conjunction), tuple(_condition(part, static) for part in formula.parts)
        )
    if isinstance(formula, Forall | Exists):
        every = isinstance(formula, Forall)
        guards, rest = _guarded(formula.body, static, negated=every)
        return Guarded(every, formula.variables, guards, rest)
    return formula


def _guarded(
    formula: Formula, static: frozenset[str], *, negated: bool = False
) -> tuple[tuple[Is, ...], Condition]:
    """Split off the static atoms among the conjuncts, or (`negated`) the negated ones among the disjuncts."""
    junction = Disjunction if negated else Conjunction
    parts = formula.parts if isinstance(formula, junction) else (formula,)
    guards: list[Is] = []
    rest: list[Formula] = []
    for part in parts:
        atom: Formula | None = part
        if negated:
            atom = part.part if isinstance(part, Negation) else None
        if isinstance(atom, Is) and atom.predicate in static:
            guards.append(atom)
        else:
            rest.append(part)
    return tuple(guards), _condition(rest[0] if len(rest) == 1 else junction(tuple(rest)), static)


def _flat(formula: Formula) -> Formula:
    """Return a conjunction without conjunctions directly inside."""
    if not isinstance(formula, Conjunction):
        return formula
    parts: list[Formula] = []
    for part in map(_flat, formula.parts):
        parts.extend(part.parts if isinstance(part, Conjunction) else (part,))
    return Conjunction(tuple(parts))
