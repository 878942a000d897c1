"""Formulas: what user rules and richer observations say, before they are clauses.

A formula is a tree of frozen values. Quantifiers range over the sorts of a model (`nodes`, `topics`, …);
after robomend.model.grounding none is left, and robomend.model.clauses turns the rest into clauses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from robomend_client.literals import Atom, Literal

AB = "ab"
"""The predicate of abnormality in rules; the clauses know it as the negated health variable."""


class Variable(str):
    """A name that a quantifier binds; it stands among the arguments of an atom like any other name."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class Leaf:
    """A literal, with its 0-based place in the sentence for the sake of errors."""

    literal: Literal
    position: int = 0


@dataclass(frozen=True, slots=True)
class Truth:
    """`true` or `false`; also what a quantifier over nothing comes to."""

    value: bool


@dataclass(frozen=True, slots=True)
class Not:
    """Negation."""

    body: Formula


@dataclass(frozen=True, slots=True)
class And:
    """Conjunction of any number."""

    parts: tuple[Formula, ...]


@dataclass(frozen=True, slots=True)
class Or:
    """Disjunction of any number."""

    parts: tuple[Formula, ...]


@dataclass(frozen=True, slots=True)
class Implies:
    """left -> right."""

    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True)
class Iff:
    """left <-> right."""

    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True)
class Quantified:
    """`forall v in sort where guard: body`, or `exists …`; the guard is a conjunction over fixed
    relations."""

    universal: bool
    variable: Variable
    sort: str
    guard: tuple[Literal, ...]
    body: Formula


Formula = Leaf | Truth | Not | And | Or | Implies | Iff | Quantified


def ab(component: str) -> Literal:
    """Return AB(component)."""
    return Literal(Atom(AB, (component,)))


def leaves(formula: Formula) -> Iterator[Leaf]:
    """Yield every leaf, from left to right."""
    ahead: list[Formula] = [formula]
    while ahead:
        match ahead.pop():
            case Leaf() as leaf:
                yield leaf
            case Implies(left, right) | Iff(left, right):
                ahead += (right, left)
            case And(parts) | Or(parts):
                ahead += reversed(parts)
            case Not(body) | Quantified(body=body):
                ahead.append(body)


def quantified(formula: Formula) -> bool:
    """Return whether a quantifier is left."""
    match formula:
        case Quantified():
            return True
        case Not(body):
            return quantified(body)
        case And(parts) | Or(parts):
            return any(quantified(part) for part in parts)
        case Implies(left, right) | Iff(left, right):
            return quantified(left) or quantified(right)
        case _:
            return False


def conjuncts(formula: Formula) -> tuple[Literal, ...] | None:
    """Return the literals of a literal or a conjunction of literals, None for anything richer."""
    match formula:
        case Leaf(literal):
            return (literal,)
        case Not(Leaf(literal)):
            return (-literal,)
        case Not(Not(body)):
            return conjuncts(body)
        case And(parts):
            found: list[Literal] = []
            for part in parts:
                inner = conjuncts(part)
                if inner is None:
                    return None
                found.extend(inner)
            return tuple(found)
        case _:
            return None
