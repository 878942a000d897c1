"""Values to columns and back: JSON text, atoms, ETags, and the limits of what a database column can hold.

An accepted batch has a module of its own, batch_text.py.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from robomend.entry import Entry, LastWord
from robomend.errors import InputError
from robomend.store.records import Json
from robomend_client.literals import Atom, Literal
from robomend_client.readings import Reading

_COMPACT = json.JSONEncoder(separators=(",", ":"), allow_nan=False)
_CANONICAL = json.JSONEncoder(separators=(",", ":"), allow_nan=False, sort_keys=True)
_ID_LETTERS = "23456789abcdefghjkmnpqrstvwxyz"  # none that look like another
INT64 = range(-(2**63), 2**63)
"""What a column of times holds."""

HOLE = "\n"
"""Where the common piece of a text goes: compact JSON has no line breaks."""


class Encoded(dict[str, Any]):
    """A JSON object that brings its compact text, so that tables and streams do not each make their own.

    It must not be changed after it was made.
    """

    __slots__ = ("common", "own", "text")

    def __init__(self, value: Mapping[str, Any], text: str | None = None) -> None:
        super().__init__(value)
        self.text = _COMPACT.encode(value) if text is None else text
        self.own = self.text
        """What a row of its own keeps: all but `common`."""
        self.common: Common | None = None
        """A part of the text that other rows have as well."""

    @classmethod
    def around(cls, value: Mapping[str, Any], before: str, common: Common, after: str) -> Encoded:
        """Return an object whose text is before + common + after, all three in pieces as they are."""
        made = cls(value, f"{before}{common.text}{after}")
        made.own, made.common = f"{before}{HOLE}{after}", common
        return made


class Common:
    """A piece of JSON text that many rows have, by which the store keeps it once (results.py)."""

    __slots__ = ("digest", "text")

    def __init__(self, text: str) -> None:
        self.text = text
        self.digest = digest(text)


def filled(own: str, common: str) -> str:
    """Return the text of an `Encoded` from what its row keeps and the piece that others have as well."""
    return own.replace(HOLE, common, 1)


def digest(text: str) -> str:
    """Return sixteen bytes, as hexadecimal digits, that no other text has."""
    return hashlib.blake2b(text.encode(errors="surrogatepass"), digest_size=16).hexdigest()


def to_json(value: object) -> str:
    """Return compact JSON; all of it ASCII, so that any string, NUL included, fits a text column."""
    if type(value) is Encoded:
        return value.text
    try:
        return _COMPACT.encode(value)
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(f"this cannot be kept as JSON: {error}") from error


def from_json(text: str) -> Any:
    """Return the value of a JSON column."""
    return json.loads(text)


def optional_json(value: Json | None) -> str | None:
    """Return JSON, or None for None."""
    return None if value is None else to_json(value)


def etag(value: Mapping[str, Any]) -> str:
    """Return a hash of the object, the same for any order of its keys."""
    try:
        canonical = _CANONICAL.encode(value)
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(f"this cannot be kept as JSON: {error}") from error
    return hashlib.sha256(canonical.encode()).hexdigest()[:20]


def new_id(prefix: str) -> str:
    """Return a short id that was never given before: 30^10 of them, and the table refuses a repeat."""
    return prefix + "".join(secrets.choice(_ID_LETTERS) for _ in range(10))


def checked(text: str) -> str:
    """Return a text that goes into a column of its own.

    Raises:
        InputError: it holds a NUL, which PostgreSQL has no place for, or half of a surrogate pair.
    """
    if "\x00" in text or not (text.isascii() or _encodable(text)):
        raise InputError(f"{text[:80]!a} holds what no column can: NUL, or half a surrogate pair")
    return text


def checked_or_none(text: str | None) -> str | None:
    """Return `checked(text)`, or None for None."""
    return None if text is None else checked(text)


def checked_ns(time_ns: int) -> int:
    """Return a time that fits 64 bits; InputError for others."""
    if time_ns not in INT64:
        raise InputError(f"the time {time_ns} ns does not fit 64 bits; nanoseconds since 1970 end in 2262")
    return time_ns


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


@lru_cache(maxsize=16384)
def atom_to_text(atom: Atom) -> str:
    """Return the atom as a JSON array."""
    return _COMPACT.encode([atom.predicate, *atom.args])


@lru_cache(maxsize=16384)
def atom_from_text(text: str) -> Atom:
    """Return the atom of a JSON array."""
    predicate, *arguments = json.loads(text)
    return Atom(predicate, tuple(arguments))


def more_of(entry: Entry) -> str | None:
    """Return what only some entries of OBS have, as JSON; None for those that have none of it.

    `r` is the reading, `s` the last word of each of several sources: the columns of an entry from `positive`
    to `settled`, its `more`, the time of the report before it.
    """
    if entry.reading is None and not entry.by_source:
        return None
    more: dict[str, Any] = {} if entry.reading is None else {"r": entry.reading.as_json()}
    if entry.by_source:
        more["s"] = [
            [
                said.positive,
                checked(said.source),
                said.time_ns,
                said.expires_ns,
                said.since_ns,
                said.onset_ns,
                said.settled,
                None if said.reading is None else {"r": said.reading.as_json()},
                before_ns,
            ]
            for said, before_ns in entry.by_source
        ]
    return _COMPACT.encode(more)


def entry_of(
    literal: Literal,
    source: str,
    time_ns: int,
    expires_ns: int | None = None,
    since_ns: int | None = None,
    onset_ns: int | None = None,
    settled: int | None = None,
    more: Mapping[str, Any] | None = None,
) -> Entry:
    """Return an entry of OBS from its columns."""
    if more is None:
        return Entry(literal, source, time_ns, expires_ns, since_ns, onset_ns, settled)
    words = tuple(
        LastWord(entry_of(Literal(literal.atom, row[0]), *row[1:8]), row[8]) for row in more.get("s", ())
    )
    reading = Reading.from_json(more["r"]) if "r" in more else None
    return Entry(literal, source, time_ns, expires_ns, since_ns, onset_ns, settled, reading, words)
