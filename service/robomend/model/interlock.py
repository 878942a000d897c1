"""`act_when` of a model: a sentence that OBS must show before anything is sent to the robot.

It is judged over what is known now, in three values (Kleene): a sentence of which nobody can say whether it
holds does not hold. So `ok(parked)` forbids every action while the robot is not parked, and as well while
nobody says whether it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from robomend.model.formulas import And, Formula, Iff, Implies, Leaf, Not, Or, Quantified, Truth, leaves
from robomend_client.literals import Atom

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
        said = [f"{_some(known)} is observed"] if known else []
        said += [f"nobody reports {_some(unknown)}"] if unknown else []
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


def _some(said: list[str]) -> str:
    more = f" and {len(said) - NAMED} more" if len(said) > NAMED else ""
    return f"{', '.join(said[:NAMED])}{more}"
