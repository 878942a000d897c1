"""Atoms and literals: the words in which observers, models and diagnoses speak.

An atom is a predicate over names, `ok(scan)`; a literal is an atom or its negation, `not ok(scan)`. Both
sides of the wire share this type; the parser of whole sentences is robomend.observations.language.

They are tuples, as they are looked up all the time: these are hashed and compared without Python's help.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple

PLAIN_NAME = re.compile(r"[A-Za-z0-9_.\-][A-Za-z0-9_./\-]*\Z")
"""A name that needs no quotes. A leading `/`, as ROS writes it, is dropped before a name gets here."""

RESERVED = frozenset({"not", "and", "or", "forall", "exists", "true", "false"})
"""Words of the sentence language; as names they need quotes."""


@lru_cache(maxsize=4096)
def quote(name: str) -> str:
    """Return `name` as sentences write it: bare where the language allows, else in double quotes."""
    if PLAIN_NAME.match(name) and "->" not in name and name not in RESERVED:
        return name
    escaped = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


class Atom(NamedTuple):
    """A predicate and its arguments; a proposition of a five-key model may have none."""

    predicate: str
    args: tuple[str, ...] = ()

    def __str__(self) -> str:
        return _shown(self)

    def __reduce__(self) -> tuple[type[Atom], tuple[str, tuple[str, ...]]]:
        return Atom, (self.predicate, self.args)  # models of thousands of them travel to workers


@lru_cache(maxsize=4096)
def _shown(atom: Atom) -> str:
    if not atom.args:
        return quote(atom.predicate)
    return f"{quote(atom.predicate)}({','.join(map(quote, atom.args))})"


class Literal(NamedTuple):
    """An atom that holds, or its negation."""

    atom: Atom
    positive: bool = True

    def __neg__(self) -> Literal:
        return Literal(self.atom, not self.positive)

    def __str__(self) -> str:
        return str(self.atom) if self.positive else f"not {self.atom}"

    def __reduce__(self) -> tuple[type[Literal], tuple[Atom, bool]]:
        return Literal, (self.atom, self.positive)


_NAME = r'(?:[^\s"(),]+|"(?:[^"\\]|\\.)*")'
_ATOM = re.compile(rf"\s*({_NAME})\s*(?:\(\s*({_NAME}(?:\s*,\s*{_NAME})*)\s*\))?\s*\Z")


def parse_atom(text: str) -> Atom:
    """Return the atom of `ok(scan)`; a bare name is short for ok(name). Names may stand in double quotes.

    Raises:
        ValueError: it is neither.
    """
    found = _ATOM.match(text)
    if found is None:
        raise ValueError(f"{text!r} is no atom; write e.g. ok(scan), or scan for short")
    names = [_plain(name) for name in re.findall(_NAME, found[2] or found[1])]
    return Atom(_plain(found[1]) if found[2] else "ok", tuple(names))


def _plain(name: str) -> str:
    """Return a name without its quotes, or without the leading slash that ROS writes."""
    if name.startswith('"'):
        return re.sub(r"\\(.)", r"\1", name[1:-1])
    return name.removeprefix("/")


def holds(predicate: str, *args: str) -> Literal:
    """Return the positive literal, e.g. `holds("ok", "scan")`."""
    return Literal(Atom(predicate, args))


def fails(predicate: str, *args: str) -> Literal:
    """Return the negative literal, e.g. `fails("ok", "scan")`, printed `not ok(scan)`."""
    return Literal(Atom(predicate, args), positive=False)
