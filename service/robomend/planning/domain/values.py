"""A repair domain as values: types, predicates, action schemas, and what the user's text adds to the problem.

`robomend.planning.domain.loading` makes one from PDDL text.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from robomend.model.components import KINDS
from robomend.planning.domain.formulas import Formula, Is, Typed
from robomend.planning.domain.sexpr import Brackets, render

PAIRS = (("good", "bad"), *((kind.state, lost) for kind in KINDS for lost in kind.lost))
"""A fact and its opposite; an action that adds one must delete the other."""


@dataclass(frozen=True, slots=True)
class Predicate:
    """A predicate and the types of its arguments."""

    name: str
    types: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Effect:
    """For all `variables` with `condition`: the atom is added, or deleted."""

    variables: Typed
    condition: Formula
    atom: Is
    adds: bool


@dataclass(frozen=True, slots=True)
class Schema:
    """An action with variables."""

    name: str
    parameters: Typed
    precondition: Formula
    effects: tuple[Effect, ...]
    cost: float
    line: int
    file: str | None


@dataclass(frozen=True, slots=True)
class Declared:
    """An object or an init fact of the user's text: words and place."""

    words: tuple[str, ...]  # an object: (name, type); a fact: (predicate, names…)
    quoted: tuple[bool, ...]
    line: int
    file: str | None


def is_a(supertype: Mapping[str, str], kind: str, wanted: str) -> bool:
    """Return whether type `kind` is `wanted` or a kind of it, given what each type is a kind of."""
    while kind != wanted:
        if kind == "object":
            return False
        kind = supertype[kind]
    return True


@dataclass(frozen=True, eq=False)
class Domain:
    """A checked domain. Compared by identity: `load_domain` gives equal texts the same one."""

    name: str
    supertype: Mapping[str, str]  # type -> the type it is a kind of; `object` is the root
    predicates: Mapping[str, Predicate]
    schemas: Mapping[str, Schema]
    constants: Mapping[str, str]  # name -> type
    objects: tuple[Declared, ...]
    facts: tuple[Declared, ...]
    source: Brackets

    @cached_property
    def static(self) -> frozenset[str]:
        """The predicates that no action changes."""
        changed = {effect.atom.predicate for schema in self.schemas.values() for effect in schema.effects}
        return frozenset(self.predicates.keys() - changed)

    def is_a(self, kind: str, wanted: str) -> bool:
        """Return whether every object of type `kind` is one of type `wanted`."""
        return is_a(self.supertype, kind, wanted)

    @cached_property
    def pddl(self) -> str:
        """The domain as PDDL text, the user's part merged in, objects and init left to the problem."""
        left_out = (":objects", ":init")
        keep = [
            item for item in self.source.items if not isinstance(item, Brackets) or item.head not in left_out
        ]
        return render(Brackets(tuple(keep), 1)) + "\n"
