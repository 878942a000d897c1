"""What a domain declares: its types, constants and predicates, each use of them checked on the way in.

    (:types …) (:constants …) (:predicates …)  ──►  DomainVocabulary  ──►  action_parser

The sections come in that order: constants and predicates are typed, so the types are complete before them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from robomend.planning.domain.formulas import Typed
from robomend.planning.domain.sexpr import Brackets, Word, fail
from robomend.planning.domain.values import Predicate, is_a
from robomend_client.near import did_you_mean

RESERVED = frozenset({"=", "and", "or", "not", "imply", "forall", "exists", "when", "increase"})
"""Words of the language, which name no predicate."""

MAX_TYPES = 1_000
"""Every use of a name walks up the kinds of its type."""


def hint(name: str, known: Collection[str]) -> str:
    """Return the end of a message on an unknown name: the one that was meant, or all there are."""
    return did_you_mean(name, known) or (f"; known are {', '.join(sorted(known))}" if known else "")


class DomainVocabulary:
    """The declared words of one domain. Every method refuses with DomainError, at the place of the word."""

    def __init__(self) -> None:
        self.supertype: dict[str, str] = {}  # type -> the type it is a kind of; `object` is the root
        self.constants: dict[str, str] = {}  # name -> type
        self.predicates: dict[str, Predicate] = {}

    # --- declarations ---------------------------------------------------------------------------

    def declare_types(self, sections: Sequence[Brackets]) -> None:
        """Read every (:types …) there is; a supertype may be declared later than its kinds."""
        for section in sections:
            for word, parent in self.typed(section.items[1:], section):
                if word.text == "object":
                    fail(word, "`object` is the root of all types and needs no declaration")
                if word.text in self.supertype:
                    fail(word, f"the type {word.text!r} is declared twice")
                self.supertype[word.text] = parent
                if len(self.supertype) > MAX_TYPES:
                    fail(word, f"more than {MAX_TYPES} types")
        for name, parent in self.supertype.items():
            if parent != "object" and parent not in self.supertype:
                fail(
                    _find(sections, parent) or sections[-1],
                    f"unknown type {parent!r}{hint(parent, self.supertype)}",
                )
            seen = {name}
            while parent != "object":
                if parent in seen:
                    fail(_find(sections, name) or sections[-1], f"the type {name!r} is a kind of itself")
                seen.add(parent)
                parent = self.supertype.get(parent, "object")

    def declare_constants(self, section: Brackets) -> None:
        """Read (:constants …)."""
        for word, kind in self.typed(section.items[1:], section):
            if word.text in self.constants:
                fail(word, f"the constant {word.text!r} is declared twice")
            self.constants[word.text] = kind

    def declare_predicates(self, section: Brackets) -> None:
        """Read (:predicates …)."""
        for item in section.items[1:]:
            if not isinstance(item, Brackets) or item.head is None:
                fail(item, "expected a predicate such as (broken ?c - component)")
            name = item.head
            if name in RESERVED:
                fail(item, f"{name!r} is a word of the language, not a predicate")
            if name in self.predicates:
                fail(item, f"the predicate {name!r} is declared twice")
            variables = self.variables(item.items[1:], item)
            self.predicates[name] = Predicate(name, tuple(kind for _, kind in variables))

    # --- uses -----------------------------------------------------------------------------------

    def typed(self, items: Sequence[Word | Brackets], where: Brackets) -> list[tuple[Word, str]]:
        """Return the words of a typed list, `a b - t c`, each with its type."""
        found: list[tuple[Word, str]] = []
        waiting: list[Word] = []
        rest = iter(items)
        for item in rest:
            if not isinstance(item, Word):
                fail(item, "expected a name, found a bracket")
            if item.text != "-" or item.quoted:
                waiting.append(item)
                continue
            kind = next(rest, None)
            if isinstance(kind, Brackets):
                fail(kind, "(either …) is not supported; declare a common supertype")
            if kind is None or not waiting:
                fail(item, "'-' stands between names and their type")
            # In (:types …) a supertype may come later: declare_types looks when it has them all.
            known = kind.text == "object" or kind.text in self.supertype or where.head == ":types"
            if not known:
                fail(kind, f"unknown type {kind.text!r}{hint(kind.text, self.supertype)}")
            found.extend((word, kind.text) for word in waiting)
            waiting = []
        return found + [(word, "object") for word in waiting]

    def variables(self, items: Sequence[Word | Brackets], where: Brackets) -> Typed:
        """Return the variables of a typed list, each name once."""
        variables: dict[str, str] = {}
        for word, kind in self.typed(items, where):
            if not word.text.startswith("?") or len(word.text) < 2:
                fail(word, f"{word.text!r} is no variable; variables start with '?'")
            if word.text in variables:
                fail(word, f"the variable {word.text} is declared twice")
            variables[word.text] = kind
        return tuple(variables.items())

    def predicate_of(self, item: Brackets) -> Predicate:
        """Return the predicate that heads an atom."""
        name = item.head or ""
        if name not in self.predicates:
            fail(item, f"unknown predicate {name!r}{hint(name, self.predicates)}")
        return self.predicates[name]

    def check_arity(self, predicate: Predicate, found: int, where: Brackets) -> None:
        """Refuse an atom with too few or too many arguments."""
        if found != len(predicate.types):
            wanted = len(predicate.types)
            fail(where, f"{predicate.name} takes {wanted} argument{'s' * (wanted != 1)}, found {found}")

    def is_a(self, kind: str, wanted: str) -> bool:
        """Return whether every object of type `kind` is one of type `wanted`."""
        return is_a(self.supertype, kind, wanted)


def _find(sections: Sequence[Brackets], name: str) -> Word | None:
    words = (word for section in sections for word in section.items if isinstance(word, Word))
    return next((word for word in words if word.text == name), None)
