"""An accepted batch as the log keeps it: one JSON text, from which three readers take what they need.

    history   entries as they were accepted, assertions, who reported        `batch_of`
    event     what changed, what was forgotten, when it was accepted         `event_of`
    OBS       the entries that OBS holds since, the atoms that it forgot     `held_of`

Mostly all three are the same entries, and the text has them once. Its keys, each left out where it says
nothing, are letters, as names would take most of the space:

    o  1: OBS has it in its own rows already (always first, so that a look tells)
    b  by: the reporter            e  the accepted entries
    h  what OBS holds of it: places in e, or entries (of `inc`, what it denies); without h, all of e
    c  how many of these, the first ones, changed what is known (the others renew it); without c, all
    f  forgotten atoms             a  asserted             w  withdrawn
    n  nanoseconds from the acceptance to the transaction
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from json.encoder import encode_basestring_ascii
from operator import is_not
from typing import Any

from robomend.entry import Entry
from robomend.store.encoding import Encoded, checked, to_json
from robomend.store.records import StoredAssertion, StoredBatch
from robomend_client.literals import Atom, Literal

_IN_ROWS = '{"o":1,'


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
    """Return one accepted batch as JSON. `in_rows`: what OBS holds of it is written beside it."""
    rows: dict[str, Any] = {"o": 1} if in_rows else {}
    rows["b"] = checked(by)
    rows["e"] = [_entry_row(entry) for entry in accepted]
    held = [*changed, *renewed]
    if len(held) != len(accepted) or any(map(is_not, held, accepted)):
        places = {id(entry): place for place, entry in enumerate(accepted)}
        rows["h"] = [places[id(entry)] if id(entry) in places else _entry_row(entry) for entry in held]
    if renewed:
        rows["c"] = len(changed)
    if forgotten:
        rows["f"] = forgotten
    if asserted:
        rows["a"] = [[a.name, a.sentence, a.source, a.time_ns, a.expires_ns] for a in asserted]
    if withdrawn:
        rows["w"] = list(withdrawn)
    rows["n"] = took_ns
    return to_json(rows)


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
    changed = [str(_literal(row)) for row in held[: rows.get("c", len(held))]]
    forgotten = [Atom(predicate, tuple(args)) for predicate, args in rows.get("f", ())]
    return told(revision, changed, forgotten, time_ns - rows.get("n", 0))


def held_of(text: str) -> tuple[list[Entry], list[Atom]]:
    """Return the entries that OBS holds since the batch, and the atoms that it forgot with it."""
    if text.startswith(_IN_ROWS) and '"f":' not in text:  # a quote inside a string has a backslash before it
        return [], []
    rows = json.loads(text)
    held = [] if "o" in rows else [_entry(row) for row in _held_rows(rows)]
    return held, [Atom(predicate, tuple(args)) for predicate, args in rows.get("f", ())]


def told(revision: int, changed: list[str], forgotten: Iterable[Atom], accepted_ns: int) -> Encoded:
    """Return the event of a batch. The encoder would take several times as long for its text."""
    atoms = [*map(str, forgotten)]
    event = {"revision": revision, "changed": changed, "forgotten": atoms, "accepted_ns": accepted_ns}
    new, gone = ",".join(map(encode_basestring_ascii, changed)), ",".join(map(encode_basestring_ascii, atoms))
    text = f'"revision":{revision},"changed":[{new}],"forgotten":[{gone}],"accepted_ns":{accepted_ns}'
    return Encoded(event, f"{{{text}}}")


def _held_rows(rows: dict[str, Any]) -> list[list[Any]]:
    accepted: list[list[Any]] = rows["e"]
    if "h" not in rows:
        return accepted
    return [accepted[row] if type(row) is int else row for row in rows["h"]]


def _entry_row(entry: Entry) -> list[Any]:
    """Return an entry as an array, without the values at its end that it has not got."""
    (predicate, args), positive = entry.literal
    row = [predicate, args, positive, entry.source, entry.time_ns]
    row += [entry.expires_ns, entry.since_ns, entry.onset_ns, entry.settled]
    while row[-1] is None:
        row.pop()
    return row


def _entry(row: list[Any]) -> Entry:
    _, _, _, *rest = row
    return Entry(_literal(row), *rest)


def _literal(row: list[Any]) -> Literal:
    predicate, args, positive = row[:3]
    return Literal(Atom(predicate, tuple(args)), positive)
