"""The formulas of PDDL conditions as values.

Terms are strings: a variable starts with `?`, everything else names an object. `(imply a b)` is read as
`(or (not a) b)`.

Not shared with robomend.model.formulas, whose leaves are literals with a place, whose quantifiers bind one
variable over a sort, and whose clauses follow polarity through `iff` instead of a negation normal form.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

Typed = tuple[tuple[str, str], ...]
"""Variables with their types, ("?h", "hardware")."""


@dataclass(frozen=True, slots=True)
class Is:
    """A predicate holds of these terms."""

    predicate: str
    terms: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Equal:
    """Two terms are the same object."""

    left: str
    right: str


@dataclass(frozen=True, slots=True)
class Negation:
    part: Formula


@dataclass(frozen=True, slots=True)
class Conjunction:
    parts: tuple[Formula, ...]


@dataclass(frozen=True, slots=True)
class Disjunction:
    parts: tuple[Formula, ...]


@dataclass(frozen=True, slots=True)
class Forall:
    variables: Typed
    body: Formula


@dataclass(frozen=True, slots=True)
class Exists:
    variables: Typed
    body: Formula


Formula = Is | Equal | Negation | Conjunction | Disjunction | Forall | Exists

TRUE: Formula = Conjunction(())


def atoms(formula: Formula) -> Iterator[Is]:
    """Yield every atom of a formula."""
    if isinstance(formula, Is):
        yield formula
    elif isinstance(formula, Negation):
        yield from atoms(formula.part)
    elif isinstance(formula, Conjunction | Disjunction):
        for part in formula.parts:
            yield from atoms(part)
    elif isinstance(formula, Forall | Exists):
        yield from atoms(formula.body)


def negation_normal(formula: Formula, negate: bool = False) -> Formula:
    """Return an equivalent formula with `not` in front of atoms and equalities only."""
    if isinstance(formula, Negation):
        return negation_normal(formula.part, not negate)
    if isinstance(formula, Is | Equal):
        return Negation(formula) if negate else formula
    if isinstance(formula, Conjunction | Disjunction):
        parts = tuple(negation_normal(part, negate) for part in formula.parts)
        return Disjunction(parts) if isinstance(formula, Conjunction) == negate else Conjunction(parts)
    body = negation_normal(formula.body, negate)
    if isinstance(formula, Forall) == negate:
        return Exists(formula.variables, body)
    return Forall(formula.variables, body)
