"""What is left of a .db3 whose end is missing. SQLite finds rows by pages that may lie behind the cut; so
here the pages that are there are looked at, one after another.

    page of rows: kind 13 | … | count of cells | … | place of each cell, u16 | cells
    cell: length of the record, row, record | where it is long: the number of the page on which it goes on
    record: length of its head, kind of each column | columns        a message: null, topic, time, bytes

Lengths, rows and kinds are numbers of 1 to 9 bytes. The format is that of sqlite.org/fileformat2.html.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robomend_batch.logs.chunk import lone_stamps
from robomend_batch.logs.recorded import LONG_NS, Channel, Message, Notes, Unreadable

ROWS = 13
"""The kind of page that holds rows."""

HEADER_BYTES = 100
"""Of the file, at the beginning of its first page."""

NUMBER_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Of whole numbers, by the kind of their column; 8 and 9 are 0 and 1."""

BYTES = 12
"""The kind of a column of no bytes; of n bytes, it is 2 n more."""


class _Row(NamedTuple):
    number: int
    topic: int
    time_ns: int
    begin: int  # of the bytes, in the record
    end: int


class CutDb3:
    """Its messages, in the order of time."""

    by_time = True
    checked: bool | None = None

    def __init__(self, path: Path, channels: list[Channel], cut: str) -> None:
        self.channels = channels
        self.cut: str | None = cut
        self._file = path.open("rb")
        head = self._file.read(HEADER_BYTES)
        (size,) = struct.unpack_from(">H", head, 16)
        self._page_bytes = 65536 if size == 1 else size
        self._there = path.stat().st_size
        self._usable = self._page_bytes - head[20]
        numbers, times, topics, places = (array("q") for _ in range(4))
        known = {channel.number for channel in channels}
        for place, row in self._rows():
            if row.topic in known:
                numbers.append(row.number)
                times.append(row.time_ns)
                topics.append(row.topic)
                places.append(place)
        self.notes = Notes()
        order = np.argsort(numbers, kind="stable") if times else np.zeros(0, dtype=np.intp)
        lone = lone_stamps(np.array(times)[order], LONG_NS)
        for _ in range(int(lone.sum())):
            self.notes.far()
        order = order[~lone]
        order = order[np.argsort(np.array(times)[order], kind="stable")]
        self._times, self._topics = np.array(times)[order], np.array(topics)[order]
        self._places = np.array(places)[order]
        if not len(order):
            raise Unreadable(f"{cut}, and what is there has no messages")
        self.start_ns: int | None = int(self._times[0])
        self.end_ns: int | None = int(self._times[-1])

    def close(self) -> None:
        self._file.close()

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        first = 0 if from_ns is None else int(np.searchsorted(self._times, from_ns))
        for at in range(first, len(self._times)):
            topic = int(self._topics[at])
            if topic not in wanted:
                continue
            data = self._bytes(int(self._places[at])) if wanted[topic] else None
            if data is not None or not wanted[topic]:  # else its bytes lie behind the cut
                yield int(self._times[at]), topic, data

    def _rows(self) -> Iterator[tuple[int, _Row]]:
        """Yield the messages in the order of the file, and where in it their cells are."""
        self._file.seek(0)
        begin = 0
        while len(page := self._file.read(self._page_bytes)) == self._page_bytes:
            head = HEADER_BYTES if begin == 0 else 0
            if page[head] == ROWS:
                (count,) = struct.unpack_from(">H", page, head + 3)
                for at in range(head + 8, min(head + 8 + 2 * count, self._page_bytes - 1), 2):
                    (place,) = struct.unpack_from(">H", page, at)
                    row = self._row(page, place)
                    if row is not None:
                        yield begin + place, row
            begin += self._page_bytes

    def _row(self, page: bytes, at: int) -> _Row | None:
        """Return the message of a cell; None if it is a row of another table."""
        try:
            _, at = _number(page, at)
            number, at = _number(page, at)
            head_end, kind_at = _number(page, at)
            head_end += at
            kinds: list[int] = []
            while kind_at < head_end and len(kinds) <= 4:
                kind, kind_at = _number(page, kind_at)
                kinds.append(kind)
            if len(kinds) != 4 or kinds[0] or kinds[3] < BYTES or kinds[3] % 2:
                return None
            topic, place = _whole(page, head_end, kinds[1])
            time_ns, place = _whole(page, place, kinds[2])
        except (IndexError, KeyError):
            return None
        return _Row(number, topic, time_ns, place - at, place - at + (kinds[3] - BYTES) // 2)

    def _bytes(self, place: int) -> bytes | None:
        """Return the bytes of a message, of the cell there; None if some of them are behind the cut."""
        begin, at = place // self._page_bytes * self._page_bytes, place % self._page_bytes
        self._file.seek(begin)
        page = self._file.read(self._page_bytes)
        row = self._row(page, at)
        length, at = _number(page, at)
        _, at = _number(page, at)
        if length > self._there:  # damaged: its pages could lead in a circle for ever
            return None
        here = self._here(length)
        record = bytearray(page[at : at + here])
        on_page = page[at + here : at + here + 4]
        while len(record) < length:
            number = int.from_bytes(on_page)
            self._file.seek(max(number - 1, 0) * self._page_bytes)
            page = self._file.read(self._page_bytes)
            if number == 0 or len(page) < self._page_bytes:
                return None
            on_page = page[:4]
            record += page[4 : self._usable]
        return None if row is None else bytes(record[row.begin : row.end])

    def _here(self, length: int) -> int:
        """Return how much of a record is in its cell."""
        most = self._usable - 35
        if length <= most:
            return length
        least = (self._usable - 12) * 32 // 255 - 23
        some = least + (length - least) % (self._usable - 4)
        return some if some <= most else least


def _number(data: bytes, at: int) -> tuple[int, int]:
    """Return a number of 1 to 9 bytes, and the place behind it."""
    value = 0
    for place in range(at, at + 8):
        value = value << 7 | data[place] & 127
        if data[place] < 128:
            return value, place + 1
    return value << 8 | data[at + 8], at + 9


def _whole(data: bytes, at: int, kind: int) -> tuple[int, int]:
    """Return a column that is a whole number, and the place behind it; KeyError if it is none."""
    if kind in (8, 9):
        return kind - 8, at
    end = at + NUMBER_BYTES[kind]
    if end > len(data):
        raise IndexError
    return int.from_bytes(data[at:end], signed=True), end
