"""Recordings in chunks, .mcap and .bag: the messages of one chunk together, and chunks in the order of time.

Nothing is taken that was not checked: an index is held against the bounds of its chunk, against its own order
and, where the chunk is unpacked, against the heads of the messages that it leads to. Where they disagree the
chunk is read itself; a chunk that cannot be read is a hole (recorded.py), and the others are read.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robomend_batch.logs.recorded import LONG_NS, Message, Notes, Stretch, Times, damage_of, hole
from robomend_client.observers.driver import JUMP_NS

LARGEST_CHUNK = 64 << 20
"""Unpacked. Recorders write chunks of 0.8 to 4 MB; what says more is damaged, or made to fill the memory."""

FEW_CHUNKS = 8
"""So many are all looked into for stamps that are far from their neighbours."""

Found = Mapping[int, tuple[Times, Times, Times]]
"""By channel, in the order of the chunk: times, and where the data of each message begins and ends."""


class Chunk:
    """The wanted messages of one chunk: their times and bytes by channel, or one by one, by time."""

    def __init__(self, found: Found, wanted: Mapping[int, bool], data: bytes | None) -> None:
        self._found = {channel: one for channel, one in found.items() if channel in wanted and len(one[0])}
        self.times_ns = {channel: times_ns for channel, (times_ns, _, _) in self._found.items()}
        self.until_ns = max((int(times_ns.max()) for times_ns in self.times_ns.values()), default=0)
        self._wanted = wanted
        self._packed = data
        self._data = np.frombuffer(data or b"", np.uint8)

    def bodies(self, channel: int) -> tuple[NDArray[np.uint8], Times, Times]:
        """Return bytes, and where the data of each message of a channel begins and ends in them."""
        _, begins, ends = self._found[channel]
        return self._data, begins, ends

    def __iter__(self) -> Iterator[Message]:
        found: list[tuple[int, int, int, int]] = []  # time, beginning, end, channel
        for channel, (times_ns, begins, ends) in self._found.items():
            found += zip(
                times_ns.tolist(), begins.tolist(), ends.tolist(), [channel] * len(times_ns), strict=True
            )
        found.sort()
        data = self._packed
        for time_ns, begin, end, channel in found:
            yield time_ns, channel, data[begin:end] if data is not None and self._wanted[channel] else None


@dataclass
class Part:
    """A chunk of a file."""

    start_ns: int
    end_ns: int  # of its last message
    place: int  # in the file
    chunk: Any  # the format's own
    far: bool = False  # whether some of its stamps are far from their neighbours
    unsure: bool = False  # and may be right nevertheless


class Chunked(ABC):
    """A file whose chunks have an index; a format says how one of them is read."""

    by_time = True
    damage: tuple[type[Exception], ...] = ()
    """What comes of damaged bytes."""

    def __init__(self) -> None:
        self.cut: str | None = None
        self.notes = Notes()
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self._parts: list[Part] = []

    @property
    def checked(self) -> bool | None:
        """See Recording."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    @abstractmethod
    def _of_part(self, part: Part, wanted: Mapping[int, bool]) -> Chunk:
        """Return the wanted messages of a chunk; one of `damage` if it cannot be read."""

    @abstractmethod
    def _stamps(self, part: Part) -> tuple[Times, Times]:
        """Return times and places of all messages of a chunk, in the order of places."""

    @abstractmethod
    def _vouched(self, part: Part) -> bool:
        """Return whether a chunk and its index say the same of all stamps; one of `damage` if unreadable."""

    @abstractmethod
    def _channels_of(self, part: Part) -> Iterable[int]:
        """Return the channels of which a chunk has messages."""

    def _place(self, parts: Sequence[Part], doubtful: Sequence[bool]) -> None:
        """Put chunks in their order, by the stamps that are not far from their neighbours.

        Args:
            parts: in the order of the file, with the bounds that the index gives them.
            doubtful: those whose bounds nothing vouches for.
        """
        if not parts:
            return
        starts = np.array([part.start_ns for part in parts], dtype=np.int64)
        ends = np.array([part.end_ns for part in parts], dtype=np.int64)
        spans = ends - starts
        odd = np.array(doubtful, dtype=np.bool_) | (spans < 0)
        odd |= (spans > 4 * np.median(spans) + JUMP_NS) | (len(parts) < FEW_CHUNKS)
        odd[1:] |= starts[1:] < ends[:-1] - JUMP_NS
        odd[:-1] |= starts[1:] < ends[:-1] - JUMP_NS
        odd[1:] |= starts[1:] > ends[:-1] + 10 * JUMP_NS
        before: int | None = None
        for number in np.flatnonzero(odd).tolist():
            part = parts[number]
            try:
                times_ns, _ = self._stamps(part)
                lone = lone_stamps(times_ns)
                if lone[:1].any() or lone[-1:].any():
                    sure = lone_stamps(times_ns, LONG_NS)
                    part.unsure = bool((lone & ~sure).any()) and not self._vouched(part)
                    lone = lone if part.unsure else sure
            except self.damage:  # told when it is read
                others = [one for one in parts if not one.far]
                after = next((one.start_ns for one in others[number + 1 :]), None)
                if doubtful[number] or spans[number] < 0:
                    known = before if before is not None else after
                    part.start_ns = part.end_ns = part.start_ns if known is None else known
                continue
            part.far = bool(lone.any())
            kept = times_ns[~lone]
            if len(kept):
                part.start_ns, part.end_ns = int(kept.min()), int(kept.max())
            before = part.end_ns
        self._parts = sorted(parts, key=lambda part: part.start_ns)
        if self._parts:
            self.start_ns = self._parts[0].start_ns
            self.end_ns = max(part.end_ns for part in self._parts)

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        for stretch, _ in self.stretches(wanted):
            yield from (message for message in stretch if from_ns is None or message[0] >= from_ns)

    def stretches(
        self, wanted: Mapping[int, bool], place: tuple[int, int] | None = None
    ) -> Iterator[Stretch]:
        """Yield the messages chunk by chunk: as a Chunk, where no other chunk has messages in between.

        A place is two chunks: the next one, and the first one that may have left messages behind it.
        """
        parts = [part for part in self._parts if not wanted.keys().isdisjoint(self._channels_of(part))]
        since, begin = place or (0, 0)
        waiting = self._left_behind(parts[since : begin + 1], wanted)
        for number in range(begin, len(parts)):
            part = parts[number]
            following = parts[number + 1] if number + 1 < len(parts) else None
            if waiting:  # chunks may overlap: what is before the next one's first message is in its place
                ready = [message for message in waiting if message[0] < part.start_ns]
                if ready:
                    waiting = waiting[len(ready) :]
                    yield ready, (since, number)
            if not waiting:
                since = number
            found = self._read(part, wanted)
            if (
                isinstance(found, Chunk)
                and not waiting
                and (following is None or found.until_ns <= following.start_ns)
            ):
                yield found, (number + 1, number + 1)
                continue
            waiting += found
            waiting.sort(key=itemgetter(0))
        if waiting:
            yield waiting, (len(parts), len(parts))

    def _read(self, part: Part, wanted: Mapping[int, bool]) -> Chunk | list[Message]:
        """Return the messages of a chunk, or that it cannot be read."""
        try:
            return self._of_part(part, wanted)
        except self.damage as error:
            self.notes.add(f"the chunk at byte {part.place} is damaged: {damage_of(error)}", bad=True)
            return [hole(part.start_ns, part.end_ns)]

    def _left_behind(self, parts: Sequence[Part], wanted: Mapping[int, bool]) -> list[Message]:
        """Return the messages of chunks that do not come before the last one of them."""
        left: list[Message] = []
        with self.notes.told_before():
            for part in parts[:-1]:
                if part.end_ns >= parts[-1].start_ns:
                    left += (
                        message for message in self._read(part, wanted) if message[0] >= parts[-1].start_ns
                    )
        return sorted(left, key=itemgetter(0))

    def _near(self, part: Part, found: Found) -> Found:
        """Return messages without those whose stamps are far from their neighbours."""
        if not part.far:
            return found
        near = {}
        for channel, (times_ns, begins, ends) in found.items():
            kept = (times_ns >= part.start_ns) & (times_ns <= part.end_ns)
            for _ in range(int((~kept).sum())):
                self.notes.far(unsure=part.unsure)
            near[channel] = times_ns[kept], begins[kept], ends[kept]
        return near


def lone_stamps(times_ns: Times, pause_ns: int = 0) -> NDArray[np.bool_]:
    """Return which times, in the order of the file, are far from those before and after, which are near.

    The first and the last one have others on one side only: a pause there of so long, or of what is usual
    between the others, makes them not far.
    """
    lone = np.zeros(len(times_ns), dtype=np.bool_)
    if len(times_ns) < 3:
        return lone
    far = np.abs(np.diff(times_ns)) > JUMP_NS
    around = np.abs(times_ns[2:] - times_ns[:-2]) <= JUMP_NS
    lone[1:-1] = far[1:] & far[:-1] & around
    usual = max(pause_ns, 2 * int(np.abs(np.diff(times_ns[1:-1])).max(initial=0)) + JUMP_NS)
    for edge, inner in ((0, 1), (-1, -2)):
        lone[edge] = abs(int(times_ns[edge]) - int(times_ns[inner])) > usual and not lone[inner]
    return lone


def by_place(times_ns: Times, places: Times) -> tuple[Times, Times] | None:
    """Return an index in the order of places, as recorders write it; None if it leads to a message twice."""
    if (places[1:] > places[:-1]).all():
        return times_ns, places
    order = np.argsort(places, kind="stable")
    places = places[order]
    return (times_ns[order], places) if (places[1:] > places[:-1]).all() else None


def in_order(times_ns: Times) -> bool:
    """Return whether of stamps by place none is earlier than the one before it, as recorders write them."""
    return bool((times_ns[1:] >= times_ns[:-1]).all())


def gathered(data: NDArray[np.uint8], places: Times, kind: np.dtype[Any]) -> NDArray[Any]:
    """Return what is at each of these places; IndexError if one is behind all that is there."""
    every: NDArray[Any] = np.ndarray((max(0, len(data) - kind.itemsize + 1),), kind, data, 0, (1,))
    return every[places]
