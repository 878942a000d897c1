"""ROS 2 recordings in SQLite (.db3). Those before Iron do not say what their types are made of: the types of
ROS 2 itself are known nevertheless.

SQLite has no checksums, but it has the time of each message twice: in its row and in an index. Where they
disagree, what is near the messages before and after is right, and the log is a bad one.
"""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import yaml

from robomend_batch.logs.db3_cut import CutDb3
from robomend_batch.logs.recorded import (
    DAMAGED,
    HOLE,
    Channel,
    Message,
    Notes,
    Recording,
    Unreadable,
    damage_of,
    hole,
)
from robomend_batch.logs.stamps import LATEST_NS
from robomend_client.observers.base import SECOND
from robomend_client.observers.driver import JUMP_NS

HEADER = struct.Struct(">16xH10xI")
"""Of an SQLite file: the size of a page, and how many there are."""


HAS_INDEX = "SELECT count(*) FROM sqlite_master WHERE type = 'index' AND name = 'timestamp_idx'"

BOUNDS = (
    "SELECT (SELECT min(timestamp) FROM messages), (SELECT max(timestamp) FROM messages),"
    " (SELECT max(id) FROM messages) - (SELECT min(id) FROM messages) + 1"
)
"""First and last time, and how many messages there are if no row was ever deleted."""

MOST_FAR = 100
"""Stamps far from their neighbours that are left out at the beginning of a file, and at its end."""

NAME = re.compile(r"^\s*name: [\"']?(/[^\s\"']+)", re.MULTILINE)
"""Of the recorder's metadata: a topic."""

MOST_METADATA = 1 << 20

LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The one in C is ten times as fast."""

DAMAGE = (*DAMAGED, sqlite3.Error)
"""What comes of damaged pages: errors of SQLite, whose text may be no UTF-8, and columns of other kinds."""


def open_db3(path: Path) -> Recording:
    """Return a recording; Unreadable if nothing of it can be read."""
    cut = _cut(path)
    if cut is None:
        return Db3(path)
    base = _opened(path)
    try:
        # SQLite refuses a file that is shorter than it says, but to whoever mends its schema.
        base.execute("PRAGMA writable_schema = ON")
        return CutDb3(path, _channels(base), cut)
    except DAMAGE as error:
        raise Unreadable(f"{cut}, and its topics cannot be read") from error
    finally:
        base.close()


def _cut(path: Path) -> str | None:
    """Return why a file ends early; None: it does not."""
    with path.open("rb") as file:
        page_bytes, pages = HEADER.unpack(file.read(HEADER.size).ljust(HEADER.size, b"\0"))
        there = file.seek(0, 2)
    whole = pages * (65536 if page_bytes == 1 else page_bytes)
    return f"cut off: {there} of {whole} bytes" if there < whole else None


def _opened(path: Path) -> sqlite3.Connection:
    left_open = path.with_name(path.name + "-wal").exists()  # by a recorder that was killed
    name = f"file:{quote(str(path.resolve()))}?mode=ro{'' if left_open else '&immutable=1'}"
    return sqlite3.connect(name, uri=True)


def _channels(base: sqlite3.Connection) -> list[Channel]:
    definitions = _definitions(base)
    return [
        Channel(
            number,
            topic.removeprefix("/"),
            kind,
            *definitions.get(kind, ("", False)),
            encoding != "ros1",
        )
        for number, topic, kind, encoding in base.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        )
    ]


def _definitions(base: sqlite3.Connection) -> dict[str, tuple[str, bool]]:
    tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type='table'")}
    if "message_definitions" not in tables:
        return {}
    query = "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
    return {kind: (text, "idl" in encoding) for kind, text, encoding in base.execute(query)}


class Db3:
    """See the module."""

    by_time = True
    checked: bool | None = None
    start_ns: int | None = None
    end_ns: int | None = None

    def __init__(self, path: Path) -> None:
        self.cut: str | None = None
        self.notes = Notes()
        self._rows: _Rows | None = None  # where the index does not agree with them
        self._base = _opened(path)
        try:
            self.channels = _channels(self._base)
            self._has_index = self._one(HAS_INDEX)[0] > 0
            try:
                self._bound()
            except DAMAGE:
                self._doubt(self.notes)
                self.start_ns, self.end_ns = self._rows.bounds() if self._rows else (None, None)
            self._compare(path)
        except DAMAGE as error:
            self._base.close()
            raise Unreadable(f"no recording, or damaged: {damage_of(error)}") from error

    def _one(self, query: str) -> Any:
        return self._base.execute(query).fetchone()

    def _bound(self) -> None:
        """Find from when to when its messages are; DAMAGE where the index has more or fewer of them."""
        first_ns, last_ns, numbers = self._one(BOUNDS)
        if first_ns is None:
            return
        if self._has_index:
            count = self._one("SELECT count(*) FROM messages INDEXED BY timestamp_idx")[0]
            if count not in (numbers, self._one("SELECT count(*) FROM messages NOT INDEXED")[0]):
                raise ValueError
        if first_ns < 0 or last_ns > LATEST_NS:
            self.notes.add("damaged: a stamp that no clock shows: left out", bad=True)
        self.start_ns = self._edge(max(first_ns, 0), 1)
        self.end_ns = self._edge(min(last_ns, LATEST_NS), -1)

    def _doubt(self, notes: Notes) -> None:
        notes.add("damaged: its rows and its index disagree", bad=True)
        self._rows = _Rows(self._base, notes, self._has_index)

    def _edge(self, time_ns: int, way: int) -> int:
        """Return the first time, or the last one, that is not far from those of the rows around it."""
        than, order = (">", "ASC") if way > 0 else ("<", "DESC")
        query = (
            f"SELECT id, timestamp FROM messages WHERE timestamp {than}= ? ORDER BY timestamp {order} LIMIT 2"
        )
        for _ in range(MOST_FAR):
            rows = self._base.execute(query, (time_ns,)).fetchall()
            if len(rows) < 2 or abs(rows[1][1] - time_ns) <= JUMP_NS:
                break
            around = self._base.execute(
                "SELECT timestamp FROM messages WHERE id IN (?, ?)", (rows[0][0] - 1, rows[0][0] + 1)
            ).fetchall()
            times = [one for (one,) in around]
            if len(times) < 2 or abs(times[0] - times[1]) > JUMP_NS:
                break
            self.notes.far()
            time_ns = rows[1][1]
        return time_ns

    def _compare(self, path: Path) -> None:
        """Hold topics and times against what the recorder wrote about all of them when it was done."""
        text = _metadata(self._base, path)
        names = set(NAME.findall(text))
        here = {f"/{channel.topic}" for channel in self.channels}
        if names and not here <= names:
            strange = ", ".join(sorted(here - names))
            self.notes.add(f"damaged: its metadata do not know the topic {strange}", bad=True)
        span = _span(text)
        if span is None or self.start_ns is None or self.end_ns is None:
            return
        if self.start_ns < span[0] - SECOND or self.end_ns > span[1] + SECOND:
            self.notes.add("damaged: its metadata have other times", bad=True)

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        if not wanted:
            return
        begin_ns, end_ns = (self.start_ns or 0 if from_ns is None else from_ns), self.end_ns or 0
        passed: tuple[Any, ...] = begin_ns, -1  # time, row
        try:
            if self._rows is None:
                kinds = {number: bytes if data else type(None) for number, data in wanted.items()}
                try:
                    with closing(self._base.execute(self._query(wanted))) as rows:
                        for row in rows:
                            time_ns, _, topic, body = row
                            if type(body) is not kinds[topic] or type(time_ns) is not int:
                                raise ValueError
                            if begin_ns <= time_ns <= end_ns:
                                passed = row
                                yield time_ns, topic, body
                    return
                except DAMAGE:
                    self._doubt(Notes() if from_ns is not None and passed[1] < 0 else self.notes)
            assert self._rows is not None
            yield from self._rows.messages(wanted, passed[:2])
        except DAMAGE as error:
            self.cut = f"damaged: {damage_of(error)}"

    def _query(self, wanted: Mapping[int, bool]) -> str:
        """Ask for messages as the index has them; the topic is NULL where a row says otherwise or is missing.

        All of the index is gone through, as a stamp that is wrong there would end a search.
        """
        others = ",".join(str(one.number) for one in self.channels if one.number not in wanted)
        data = ",".join(str(number) for number in wanted if wanted[number])
        return (
            "SELECT m.timestamp, m.id, CASE WHEN r.timestamp = m.timestamp THEN r.topic_id END topic,"
            f" CASE WHEN r.topic_id IN ({data}) THEN data END"
            f" FROM (SELECT id, timestamp FROM messages {'INDEXED BY timestamp_idx' * self._has_index}) m"
            " LEFT JOIN messages r ON r.id = m.id"
            f" WHERE (r.timestamp = m.timestamp AND r.topic_id IN ({others})) IS NOT TRUE"
            " ORDER BY m.timestamp, m.id"
        )

    def close(self) -> None:
        self._base.close()


class _Rows:
    """The messages of a file whose rows and index disagree."""

    def __init__(self, base: sqlite3.Connection, notes: Notes, has_index: bool) -> None:
        self._base = base
        by_row = _until_damaged(base, "SELECT id, timestamp, topic_id FROM messages NOT INDEXED")
        topics = {number: topic for number, _, topic in by_row}
        said: dict[int, list[int]] = {}
        for number, time_ns, _ in by_row:
            said.setdefault(number, []).append(time_ns)
        if has_index:
            query = "SELECT id, timestamp, 0 FROM messages INDEXED BY timestamp_idx"
            for number, time_ns, _ in _until_damaged(base, query):
                said.setdefault(number, []).append(time_ns)
        sure = {number: times[0] for number, times in said.items() if len(set(times)) == 1 and len(times) > 1}
        if not sure:  # the index is lost: its rows are taken at their word
            sure = {number: times[0] for number, times in said.items()}
        order = sorted(said)
        self._found: list[tuple[int, int, int]] = []  # time, row, topic; a HOLE: the row is lost
        for at, number in enumerate(order):
            known = sure.get(number)
            if known is None:
                around = [sure[one] for one in (*order[max(0, at - 20) : at][::-1],) if one in sure][:1]
                around += [sure[one] for one in order[at + 1 : at + 21] if one in sure][:1]
                near = {
                    one
                    for one in said[number]
                    if around and min(around) - JUMP_NS <= one <= max(around) + JUMP_NS
                }
                if len(near) != 1:
                    notes.far()
                    continue
                (known,) = near
            self._found.append((known, number, topics.get(number, HOLE)))
        self._found.sort()

    def bounds(self) -> tuple[int | None, int | None]:
        return (self._found[0][0], self._found[-1][0]) if self._found else (None, None)

    def messages(self, wanted: Mapping[int, bool], passed: tuple[int, int]) -> Iterator[Message]:
        """Yield those behind a time and a row."""
        for time_ns, number, topic in self._found:
            if (time_ns, number) <= passed:
                continue
            if topic == HOLE:
                yield hole(time_ns, time_ns)
            elif topic in wanted:
                body = None
                if wanted[topic]:
                    row = self._base.execute(
                        "SELECT data FROM messages NOT INDEXED WHERE id = ?", (number,)
                    ).fetchone()
                    if row is None or not isinstance(row[0], bytes):
                        yield hole(time_ns, time_ns)
                        continue
                    body = row[0]
                yield time_ns, topic, body


def _until_damaged(base: sqlite3.Connection, query: str) -> list[tuple[int, int, int]]:
    """Return the rows that can be read, of whole numbers."""
    found = []
    try:
        for row in base.execute(query):
            if all(isinstance(one, int) for one in row):
                found.append(row)
    except DAMAGE:
        pass
    return found


def _metadata(base: sqlite3.Connection, path: Path) -> str:
    """Return what the recorder wrote when it was done, in the file (since Iron) or beside it; else ""."""
    try:
        row = base.execute("SELECT metadata FROM metadata ORDER BY id DESC LIMIT 1").fetchone()
        return str(row[0]) if row else ""
    except sqlite3.Error:
        beside = path.with_name("metadata.yaml")
        text = beside.read_text("utf-8", errors="replace") if beside.is_file() else ""
        return text if path.name in text else ""


def _span(metadata: str) -> tuple[int, int] | None:
    """Return from when to when all was recorded; None where the metadata do not say: it was never closed."""
    try:
        read = yaml.load(metadata[:MOST_METADATA], LOADER)
        said = read.get("rosbag2_bagfile_information", read)
        start_ns = int(said["starting_time"]["nanoseconds_since_epoch"])
        end_ns = start_ns + int(said["duration"]["nanoseconds"])
        return (start_ns, end_ns) if said["message_count"] else None
    except (yaml.YAMLError, *DAMAGED):
        return None
