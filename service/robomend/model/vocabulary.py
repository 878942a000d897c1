"""The words that observations of one model may use, and the one spelling of each.

A predicate takes arguments of given sorts (`on` a device, `matched` two values), or an atom is declared by
itself: the wires of a circuit, the propositions of a five-key file, whatever the user's own rules speak of.
Everything that reads a sentence asks here, so that `ok(/scan)`, `cons(v)` and `matched(b,a)` are one atom
with `ok(scan)`, `const(v)` and `matched(a,b)` wherever they came from.

To add a predicate of component models: give it its signatures in `vocabulary_of` of robomend.model.compiling;
if clauses mention it, add the clause in robomend.model.schemes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, islice

from robomend.errors import ObservationError
from robomend_client.literals import Atom, Literal, quote
from robomend_client.near import LOOKED_AT, did_you_mean

Signature = tuple[str, ...]
"""The sorts of a predicate's arguments."""

TRENDS = ("inc", "dec", "const")
"""Exactly one trend of a value holds: asserting one denies the others."""

SYMMETRIC = frozenset({"matched"})
SPELLINGS = {"con": "const", "cons": "const"}
"""The trend word of the released observer and of the released model, and the paper's."""

ACTIVE = "active"
"""active(f, v): the function f works by its variant v now; only of models that have functions."""

HAS_VARIANT = "has_variant"

DECIDED = frozenset({"ab", "AB", "nab", "NAB"})
"""What a diagnosis decides, so no observation says it."""


@dataclass(frozen=True)
class Vocabulary:
    """The declared atoms of a model. Immutable and shared by every robot that follows the model."""

    sorts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Sort -> its members in the order of the model; the quantifiers of sentences range over these."""
    predicates: Mapping[str, tuple[Signature, ...]] = field(default_factory=dict)
    atoms: frozenset[Atom] = frozenset()
    """Declared one by one: atoms of user rules, five-key propositions, the wires of a circuit."""
    relations: Mapping[str, frozenset[tuple[str, ...]]] = field(default_factory=dict)
    """What the model itself fixes, e.g. drives(node, hardware): the `where` of a quantifier joins over
    these."""
    negative_prefix: str = "not_"

    def canonical(self, literal: Literal) -> Literal:
        """Return the literal in the one spelling that OBS, clauses and plans use.

        Names lose a leading `/`, `con` and `cons` become `const`, the arguments of a symmetric predicate are
        put in order, and `not_ok(scan)` becomes `not ok(scan)` where `ok` is a predicate and `not_ok` is
        none.
        """
        atom = literal.atom
        predicate, args, positive = atom.predicate, atom.args, literal.positive
        prefix = self.negative_prefix
        while prefix and predicate.startswith(prefix) and not self._knows(predicate, args):
            if not self._knows(predicate[len(prefix) :], args):
                break
            predicate, positive = predicate[len(prefix) :], not positive
        if predicate in SPELLINGS and len(args) == 1:
            predicate = SPELLINGS[predicate]
        if any(arg.startswith("/") for arg in args):
            args = tuple(arg.lstrip("/") or arg for arg in args)
        if predicate in SYMMETRIC and len(args) == 2 and args[1] < args[0]:
            args = (args[1], args[0])
        if predicate == atom.predicate and args == atom.args and positive == literal.positive:
            return literal
        return Literal(Atom(predicate, args), positive)

    def declares(self, atom: Atom) -> bool:
        """Return whether observations may speak of this atom (in its canonical spelling)."""
        if atom in self.atoms:
            return True
        if atom.predicate == ACTIVE and ACTIVE in self.predicates:
            return atom.args in self.relations[HAS_VARIANT]
        members = self._members
        for signature in self.predicates.get(atom.predicate, ()):
            if len(signature) == len(atom.args) and all(
                arg in members[sort] for arg, sort in zip(atom.args, signature, strict=True)
            ):
                return True
        return False

    def check(self, literal: Literal, sentence: str | None = None, position: int = 0) -> Literal:
        """Return the canonical literal.

        Raises:
            ObservationError: the model declares no such atom; the message names what is near, or what is
            allowed.
        """
        canonical = self.canonical(literal)
        if self.declares(canonical.atom):
            return canonical
        message = self._why_undeclared(canonical.atom)
        raise ObservationError(message, str(literal) if sentence is None else sentence, position)

    @cached_property
    def cache(self) -> tuple[dict[str, tuple[Literal, ...]], dict[str, tuple[Literal, ...]]]:
        """Sentences read so far, strictly and with unknown names kept; robomend.observations.language
        bounds it."""
        return {}, {}

    def prepare(self) -> None:
        """Make ready what the first look-up makes: milliseconds where there are ten thousands of names."""
        _ = self._members

    @cached_property
    def _members(self) -> Mapping[str, frozenset[str]]:
        return {sort: frozenset(names) for sort, names in self.sorts.items()}

    @cached_property
    def _arities(self) -> frozenset[tuple[str, int]]:
        """Each known predicate with each number of arguments that it takes."""
        by_signature = {
            (name, len(signature)) for name, signatures in self.predicates.items() for signature in signatures
        }
        return frozenset(by_signature | {(atom.predicate, len(atom.args)) for atom in self.atoms})

    @cached_property
    def _alike(self) -> Mapping[str, dict[int, tuple[set[str], ...]]]:
        """Each predicate, sorted; with each arity of those declared atom by atom, the names at each place."""
        found: dict[str, dict[int, tuple[set[str], ...]]] = {
            name: {} for name in sorted({predicate for predicate, _ in self._arities})
        }
        for atom in self.atoms:
            places = found[atom.predicate].setdefault(len(atom.args), tuple(set() for _ in atom.args))
            for names, arg in zip(places, atom.args, strict=True):
                names.add(arg)
        return found

    def _knows(self, predicate: str, args: tuple[str, ...]) -> bool:
        return (SPELLINGS.get(predicate, predicate), len(args)) in self._arities

    def _why_undeclared(self, atom: Atom) -> str:
        if atom.predicate in DECIDED and len(atom.args) == 1:
            return (
                f"{atom} is what a diagnosis decides, not an observation; to suppose it, "
                "assume the component healthy or abnormal"
            )
        if atom.predicate not in self._alike:
            names = self._alike.keys()
            near = did_you_mean(atom.predicate, names, quote)
            return f"no predicate is named {quote(atom.predicate)}{near or '; known are ' + _some(names)}"
        signatures = [s for s in self.predicates.get(atom.predicate, ()) if len(s) == len(atom.args)]
        alike = self._alike[atom.predicate].get(len(atom.args))
        if not signatures and alike is None:
            arities = sorted({n for name, n in self._arities if name == atom.predicate})
            return (
                f"{quote(atom.predicate)} takes {' or '.join(map(str, arities))} names, not {len(atom.args)}"
            )
        for index, arg in enumerate(atom.args):
            sorts = [signature[index] for signature in signatures]
            choices = [self._members[sort] for sort in sorts] + ([alike[index]] if alike else [])
            if not any(arg in names for names in choices):
                what = " or ".join(dict.fromkeys(_SINGULAR.get(sort, sort) for sort in sorts)) or "name"
                # Of very many names only some are looked at: one bad sentence must not hold everybody up.
                allowed = sorted({*islice(chain.from_iterable(choices), LOOKED_AT)})
                near = did_you_mean(arg, allowed, quote)
                declared = _some(allowed, count=sum(map(len, choices)))
                if instead := self._instead(atom, arg):
                    return f"{instead}; no {what} is named {quote(arg)}"
                return f"no {what} is named {quote(arg)}{near or '; declared are ' + declared}"
        return f"{atom} is not declared: its names do not go together"

    def _instead(self, atom: Atom, name: str) -> str:
        """Return what may be said of a name that another predicate takes: `not ok(lidar)` of a device."""
        if len(atom.args) != 1:
            return ""
        words = {
            f"{predicate}({quote(name)})": _SINGULAR.get(signature[0], signature[0])
            for predicate, signatures in self.predicates.items()
            for signature in signatures
            if len(signature) == 1 and predicate != atom.predicate and name in self._members[signature[0]]
        }
        if not words:
            return ""
        kind = next(iter(words.values()))
        what = kind if kind == "hardware" else f"a {kind}"
        return f"{quote(name)} is {what}: write {' or '.join(list(words)[:3])}"

    def __getstate__(self) -> dict[str, object]:
        """Pickle the declarations without what was computed from them."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


_SINGULAR = {
    "components": "component",
    "nodes": "node",
    "topics": "topic",
    "properties": "property",
    "values": "value",
    "switchable": "switchable device",
    "node_resources": "resource",
    "channel_readings": "reading",
    "functions": "function",
    "variants": "variant",
    "nets": "net",
}


def _some(names: Collection[str], most: int = 12, count: int | None = None) -> str:
    count = len(names) if count is None else count
    shown = ", ".join(map(quote, islice(names, most))) or "none"
    return shown if count <= most else f"{shown}, … ({count} in all)"
