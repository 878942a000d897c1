"""ROS 2 recordings in SQLite (.db3). Those before Iron do not say what their types are made of: ROS 2's own
types are known nevertheless.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from robomend_batch.logs.db3_cut import CutDb3
from robomend_batch.logs.recorded import DAMAGED, Channel, Message, Recording, Unreadable

HEADER = struct.Struct(">16xH10xI")
"""Of an SQLite file: the size of a page, and how many there are."""


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

    def __init__(self, path: Path) -> None:
        self.cut: str | None = None
        self._base = _opened(path)
        try:
            self.channels = _channels(self._base)
            query = "SELECT min(timestamp), max(timestamp) FROM messages"
            self.start_ns, self.end_ns = self._base.execute(query).fetchone()
            if not isinstance(self.end_ns, int | None):
                raise ValueError(f"a time that is {self.end_ns!r}")
        except DAMAGE as error:
            self._base.close()
            raise Unreadable(f"no recording, or damaged: {error}") from error

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        if not wanted:
            return
        marks = ",".join(map(str, sorted(wanted)))
        data = "data" if any(wanted.values()) else "NULL"
        query = f"SELECT timestamp, topic_id, {data} FROM messages WHERE topic_id IN ({marks})"
        query += " AND timestamp >= ? ORDER BY timestamp, id"
        try:
            with closing(self._base.execute(query, (-1 << 63 if from_ns is None else from_ns,))) as rows:
                for time_ns, number, body in rows:
                    if not isinstance(time_ns, int) or not isinstance(body, bytes | None):
                        raise ValueError(f"a time that is {time_ns!r}, bytes that are {type(body).__name__}")
                    yield time_ns, number, body if wanted[number] else None
        except DAMAGE as error:
            self.cut = f"damaged: {error}"

    def close(self) -> None:
        self._base.close()
