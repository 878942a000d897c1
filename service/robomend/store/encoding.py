"""Values to columns and back: JSON text, atoms, ETags, the limits of what a database column can hold, and the
text that an accepted batch is in the log.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from json.encoder import encode_basestring_ascii
from operator import is_not
from typing import Any

from robomend.entry import Entry, LastWord
from robomend.errors import InputError
from robomend.store.records import Json, StoredAssertion, StoredBatch
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
    """A piece of JSON text that many rows have, by which the store keeps it once (the table `results`)."""

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

    `r` is the reading, `d` that its source is deaf, `s` the last word of each of several sources: the columns
    of an entry from `positive` to `settled`, its `more`, the time of the report before it.
    """
    more = _own_more_of(entry)
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
                _own_more_of(said) or None,
                before_ns,
            ]
            for said, before_ns in entry.by_source
        ]
    return _COMPACT.encode(more) if more else None


def _own_more_of(entry: Entry) -> dict[str, Any]:
    more: dict[str, Any] = {} if entry.reading is None else {"r": entry.reading.as_json()}
    return {**more, "d": 1} if entry.deaf else more


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
    deaf = "d" in more
    return Entry(literal, source, time_ns, expires_ns, since_ns, onset_ns, settled, reading, words, deaf)


# --- an accepted batch as the log keeps it: one JSON text, from which three readers take what they need.
#
#     history   entries as they were accepted, assertions, who reported        `batch_of`
#     event     what changed, what was forgotten, when it was accepted         `event_of`
#     OBS       the entries that OBS holds since, the atoms that it forgot     `held_of`
#
# Mostly all three are the same entries, and the text has them once. Its keys, each left out where it says
# nothing, are letters, as names would take most of the space:
#
#     o  1: OBS has it in its own rows already (always first, so that a look tells)
#     b  by: the reporter            e  the accepted entries
#     h  what OBS holds of it: places in e, or entries (of `inc`, what it denies); without h, all of e
#     c  how many of these, the first ones, changed what is known (the others renew it); without c, all
#     f  forgotten atoms             a  asserted             w  withdrawn
#     n  nanoseconds from the acceptance to the transaction

Held = tuple[bool, str, int, int | None, int | None, int | None, int | None, str | None]
"""The columns of a row of OBS from `positive` to `more`."""

_IN_ROWS = '"o":1,'


def batch_to_text(
    accepted: Sequence[Entry],
    changed: Sequence[Entry],
    renewed: Sequence[Entry],
    forgotten: Sequence[Atom],
    asserted: Sequence[StoredAssertion],
    withdrawn: Sequence[str],
    *,
    by: str,
    took_ns: int,
    in_rows: bool,
) -> str:
    """Return one accepted batch as JSON. InputError: of an entry that no row of OBS takes.

    It is written by hand: the encoder would take several times as long, for each change of each robot.

    Args:
        in_rows: what OBS holds of it is written beside it.
    """
    entries = [*map(_entry_text, accepted)]
    text = f'{{{_IN_ROWS if in_rows else ""}"b":{_string(by)},"e":[{",".join(entries)}]'
    held = [*changed, *renewed] if renewed else changed
    if len(held) != len(accepted) or any(map(is_not, held, accepted)):
        places = {id(entry): str(place) for place, entry in enumerate(accepted)}
        text += f',"h":[{",".join([places.get(id(entry)) or _entry_text(entry) for entry in held])}]'
    if renewed:
        text += f',"c":{len(changed)}'
    if forgotten or asserted or withdrawn:
        more: dict[str, Any] = {"f": forgotten} if forgotten else {}
        if asserted:
            more["a"] = [[a.name, a.sentence, a.source, a.time_ns, a.expires_ns] for a in asserted]
        if withdrawn:
            more["w"] = withdrawn
        text += f",{to_json(more)[1:-1]}"
    return f'{text},"n":{took_ns}}}'


def batch_of(text: str, robot: str, revision: int, time_ns: int) -> StoredBatch:
    """Return the batch as it was accepted."""
    rows = json.loads(text)
    entries = tuple([_entry(row) for row in rows["e"]])
    asserted = tuple(StoredAssertion(*row) for row in rows.get("a", ()))
    withdrawn = tuple(rows.get("w", ()))
    return StoredBatch(robot, revision, time_ns, entries, asserted, withdrawn, rows.get("b", ""))


def event_of(text: str, revision: int, time_ns: int) -> Encoded:
    """Return what the event of the batch told."""
    rows = json.loads(text)
    held = _held_rows(rows)
    changed = [_entry(row) for row in held[: rows.get("c", len(held))]]
    forgotten = [Atom(predicate, tuple(args)) for predicate, args in rows.get("f", ())]
    return told(revision, changed, forgotten, time_ns - rows.get("n", 0))


def held_of(text: str) -> tuple[list[tuple[str, Held]], list[str]]:
    """Return what OBS holds since the batch, as columns of its rows, and what it forgot: atoms as texts."""
    in_rows = text.startswith(_IN_ROWS, 1)
    if in_rows and '"f":' not in text:  # a quote inside a string has a backslash before it
        return [], []
    rows = json.loads(text)
    held = [] if in_rows else [(_atom_text(row[0], row[1]), _columns(*row)) for row in _held_rows(rows)]
    return held, [_atom_text(predicate, args) for predicate, args in rows.get("f", ())]


def told(revision: int, changed: Iterable[Entry], forgotten: Iterable[Atom], accepted_ns: int) -> Encoded:
    """Return the event of a batch. The encoder would take several times as long for its text."""
    literals, atoms = [], [*map(str, forgotten)]
    readings: dict[str, Any] = {}
    for entry in changed:
        if entry.contradicted:
            atoms.append(str(entry.atom))
            continue
        literals.append(literal := str(entry.literal))
        if entry.reading is not None:
            readings[literal] = entry.measured()
    event = {"revision": revision, "changed": literals, "forgotten": atoms, "accepted_ns": accepted_ns}
    new = ",".join(map(encode_basestring_ascii, literals))
    gone = ",".join(map(encode_basestring_ascii, atoms))
    text = f'"revision":{revision},"changed":[{new}],"forgotten":[{gone}],"accepted_ns":{accepted_ns}'
    if readings:
        event["readings"] = readings
        text += f',"readings":{to_json(readings)}'
    return Encoded(event, f"{{{text}}}")


def _held_rows(rows: dict[str, Any]) -> list[list[Any]]:
    accepted: list[list[Any]] = rows["e"]
    if "h" not in rows:
        return accepted
    return [accepted[row] if type(row) is int else row for row in rows["h"]]


@lru_cache(maxsize=16384)
def _atom(atom: Atom) -> str:
    """Return an atom as it begins an entry: its predicate and its arguments."""
    return f"{encode_basestring_ascii(atom.predicate)},{to_json(atom.args)}"


@lru_cache(maxsize=1024)
def _string(text: str) -> str:
    """Return a string as JSON. InputError: no column takes it."""
    return encode_basestring_ascii(checked(text))


def _atom_text(predicate: str, args: list[str]) -> str:
    return atom_to_text(Atom(predicate, tuple(args)))


def _entry_text(entry: Entry) -> str:
    """Return an entry as an array, without the values at its end that it has not got."""
    atom, positive = entry.literal
    text = f"[{_atom(atom)},{'true' if positive else 'false'},{_string(entry.source)},{_ns(entry.time_ns)}"
    times: tuple[int | None, ...] = (entry.expires_ns, entry.since_ns, entry.onset_ns, entry.settled)
    more = more_of(entry)
    if more is not None:
        return f"{text}{''.join([f',{_ns(value)}' for value in times])},{more}]"
    while times and times[-1] is None:
        times = times[:-1]
    return f"{text}{''.join([f',{_ns(value)}' for value in times])}]"


def _ns(value: int | None) -> str:
    return "null" if value is None else str(value if value in INT64 else checked_ns(value))


def _columns(
    _predicate: str,
    _args: Sequence[str],
    positive: bool,
    source: str,
    time_ns: int,
    expires_ns: int | None = None,
    since_ns: int | None = None,
    onset_ns: int | None = None,
    settled: int | None = None,
    more: Json | None = None,
) -> Held:
    """Return the columns of an entry as it is in the text."""
    text = None if more is None else to_json(more)
    return positive, source, time_ns, expires_ns, since_ns, onset_ns, settled, text


def _entry(row: list[Any]) -> Entry:
    return entry_of(_literal(row), *row[3:])


def _literal(row: list[Any]) -> Literal:
    predicate, args, positive = row[:3]
    return Literal(Atom(predicate, tuple(args)), positive)
