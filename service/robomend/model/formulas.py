"""Formulas: what user rules and richer observations say, before they are clauses.

A formula is a tree of frozen values. Quantifiers range over the sorts of a model (`nodes`, `topics`, …);
after robomend.model.rules none is left, and robomend.model.clauses turns the rest into clauses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from robomend_client.counts import first_few
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


# --- `act_when` of a model: a sentence that OBS must show before anything is sent to the robot.
#
# It is judged over what is known now, in three values (Kleene): a sentence of which nobody can say whether
# it holds does not hold. So `ok(parked)` forbids every action while the robot is not parked, and as well
# while nobody says whether it is.

Value = Callable[[Atom], bool | None]
"""Whether an atom is observed to hold; None: nobody knows, or the observation is stale."""

NAMED = 5
"""Observations that a reason lists."""


@dataclass(frozen=True, slots=True)
class Interlock:
    """The sentence, as written and as a ground formula."""

    text: str
    formula: Formula

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """What it speaks of, each once."""
        return tuple(dict.fromkeys(leaf.literal.atom for leaf in leaves(self.formula)))

    def why_not(self, value: Value) -> str | None:
        """Return why nothing may be sent now, or None: OBS shows the sentence."""
        if truth(self.formula, value) is True:
            return None
        seen = {atom: value(atom) for atom in self.atoms}
        unknown = [str(atom) for atom, holds in seen.items() if holds is None]
        known = [str(atom) if holds else f"not {atom}" for atom, holds in seen.items() if holds is not None]
        said = [f"{first_few(known, NAMED)} is observed"] if known else []
        said += [f"nobody reports {first_few(unknown, NAMED)}"] if unknown else []
        return f"act_when of the model, `{self.text}`, is not what is observed: {', '.join(said) or 'never'}"


def truth(formula: Formula, value: Value) -> bool | None:
    """Return whether a ground formula holds; None: what is known does not decide it.

    Source: S. C. Kleene. Introduction to metamathematics. 1952, the strong three-valued logic.
    """
    match formula:
        case Leaf(literal):
            known = value(literal.atom)
            return None if known is None else known == literal.positive
        case Truth(always):
            return always
        case Not(body):
            return _not(truth(body, value))
        case And(parts):
            return _all(truth(part, value) for part in parts)
        case Or(parts):
            return _not(_all(_not(truth(part, value)) for part in parts))
        case Implies(left, right):
            return truth(Or((Not(left), right)), value)
        case Iff(left, right):
            one, other = truth(left, value), truth(right, value)
            return None if one is None or other is None else one == other
        case Quantified():
            raise AssertionError("a ground formula has no quantifier")


def _not(known: bool | None) -> bool | None:
    return None if known is None else not known


def _all(values: Iterable[bool | None]) -> bool | None:
    found = set(values)
    return False if False in found else None if None in found else True
