"""A recording of messages, whatever its format: its channels, and its messages in the order of time."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from robomend_client.observers.base import SECOND
from robomend_client.observers.driver import JUMP_NS

Times = NDArray[np.int64]

SLICE = 4096
"""Messages of a stretch, where the recording has none."""

Message = tuple[int, int, bytes | None]
"""Time in nanoseconds, channel, and its bytes if they were asked for."""

LONG_NS = 3600 * SECOND
"""A time that is so far from the one before is none."""

HOLE = -1
"""The channel of what is none: from its time on nothing is known, up to the time that its bytes say and up to
the next message."""

UNTIL = struct.Struct("<q")


def hole(start_ns: int, end_ns: int) -> Message:
    """Say that what was recorded in this time could not be read."""
    return start_ns, HOLE, UNTIL.pack(max(start_ns, end_ns))


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of one type; a topic may have several, of several publishers."""

    number: int
    topic: str  # without a leading slash
    type_name: str  # as rosbags writes it: sensor_msgs/msg/Imu
    definition: str  # of the type; empty: the recording does not say
    idl: bool
    cdr: bool  # ROS 2's encoding, else ROS 1's
    publisher: str = ""  # the node, with its slash; empty: the recording does not say


class Notes:
    """What is wrong with a recording: reason and whether it is read in part for that."""

    def __init__(self) -> None:
        self._found: list[tuple[str, bool]] = []
        self._told_before = False

    def add(self, reason: str, *, bad: bool) -> None:
        """Note something."""
        if not self._told_before:
            self._found.append((reason, bad))

    def far(self, *, unsure: bool = False) -> None:
        """A stamp is far from its neighbours; unsure: it has them on one side only, and may be right."""
        why = ", and nothing vouches for it" if unsure else ""
        self.add(f"a stamp is far from those of the messages around it{why}: left out", bad=unsure)

    def take(self) -> list[tuple[str, bool]]:
        """Return them, once."""
        found, self._found = self._found, []
        return found

    @contextmanager
    def told_before(self) -> Iterator[None]:
        """What is noted meanwhile was noted before."""
        before, self._told_before = self._told_before, True
        yield
        self._told_before = before


class Span:
    """First and last time of messages in the order of a file, without stamps far from their neighbours."""

    def __init__(self) -> None:
        self._first: int | None = None  # nothing came near it yet
        self._held: int | None = None  # likewise, and it is the newest
        self._last: int | None = None
        self._start: int | None = None
        self._end: int | None = None
        self._gap_ns = 0

    def add(self, time_ns: int) -> None:
        """Take in a message's time."""
        held, last = self._held, self._last
        if held is None:
            if last is not None and -JUMP_NS <= time_ns - last <= JUMP_NS:
                self._accept(time_ns)
            else:
                self._held = time_ns
            return
        self._held = None
        if abs(time_ns - held) <= JUMP_NS:
            self._accept(held)
            self._accept(time_ns)
        elif last is None:
            if self._first is None:
                self._first = held
            elif self._first < held < time_ns:
                self._accept(held)  # a recording of few messages
            self._held = time_ns
        elif abs(time_ns - last) <= JUMP_NS:
            self._accept(time_ns)
        else:
            if last < held < time_ns:
                self._accept(held)
            self._held = time_ns

    def bounds(self, notes: Notes, *, sure: bool) -> tuple[int, int] | None:
        """Return the first and the last time; None: there are no messages.

        Args:
            notes: of a first or a last message that is left out, and may be right.
            sure: what is read has a checksum.
        """
        edges = [time_ns for time_ns in (self._first, self._held) if time_ns is not None]
        if self._start is None or self._end is None:
            return (min(edges), max(edges)) if edges else None
        start, end = self._start, self._end
        usual_ns = LONG_NS if sure else 2 * self._gap_ns + JUMP_NS
        for time_ns in edges:
            if start - usual_ns <= time_ns <= end + usual_ns:
                start, end = min(start, time_ns), max(end, time_ns)
            elif self._start - LONG_NS <= time_ns <= self._end + LONG_NS:
                notes.far(unsure=True)
        return start, end

    def _accept(self, time_ns: int) -> None:
        if self._last is not None:
            self._gap_ns = max(self._gap_ns, time_ns - self._last)
        self._last = time_ns
        self._start = time_ns if self._start is None else min(self._start, time_ns)
        self._end = time_ns if self._end is None else max(self._end, time_ns)


class Recording(Protocol):
    """What a reader of a format makes of a file.

    Raises, while it is made: Unreadable if nothing of it can be read.
    """

    channels: list[Channel]
    start_ns: int | None
    """Of the first message of any topic; None: there is none."""

    end_ns: int | None
    """Of the last one."""

    cut: str | None
    """Why it ends early; None: it does not. Known when all messages were read."""

    by_time: bool
    """Whether its messages come in the order of time."""

    notes: Notes
    """What was wrong with it, since somebody took them."""

    @property
    def checked(self) -> bool | None:
        """Whether checksums of its own cover all that it holds. None: they need not, as what is in it
        twice differs where a byte is damaged; unless the file as a whole is compressed.
        """
        ...

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        """Yield the messages of channels, and holes.

        Args:
            wanted: whether their bytes are needed.
            from_ns: only those from then on, if it is `by_time`.
        """
        ...

    def close(self) -> None:
        """Close the file."""
        ...


Stretch = tuple[Iterable[Message], Any]
"""Some messages, and the place behind them, from which one can go on; None: one cannot."""


@runtime_checkable
class InStretches(Protocol):
    """A recording that hands on messages together where it can."""

    def stretches(self, wanted: Mapping[int, bool], place: Any = None) -> Iterator[Stretch]:
        """Yield all of `messages`, in their order, some of them as a Chunk.

        Args:
            wanted: as for `messages`.
            place: a stretch's, to go on behind it; None: from the beginning.
        """
        ...


@dataclass
class Passed:
    """How many messages there were; of a recording in the order of time, of those of the last one's time."""

    last_ns: int | None = None
    count: int = 0


class Sliced:
    """Any recording in stretches of so many messages; each is to be used up before the next one."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def stretches(self, wanted: Mapping[int, bool], place: Passed | None = None) -> Iterator[Stretch]:
        """Yield all messages, as InStretches does."""
        passed = place or Passed()
        messages = self._recording.messages(wanted, passed.last_ns)
        deque(islice(messages, passed.count), maxlen=0)
        while (first := next(messages, None)) is not None:
            yield self._counted(chain([first], islice(messages, SLICE - 1)), passed), passed

    def _counted(self, messages: Iterable[Message], passed: Passed) -> Iterator[Message]:
        by_time = self._recording.by_time
        last_ns, count = passed.last_ns, passed.count
        for message in messages:
            if by_time and message[0] != last_ns:
                last_ns, count = message[0], 0
            count += 1
            yield message
        passed.last_ns, passed.count = last_ns, count


class Unreadable(Exception):
    """A file of which nothing can be read."""


DAMAGED = (
    *(OSError, ValueError, EOFError, struct.error, RuntimeError, AssertionError),
    *(KeyError, IndexError, TypeError, AttributeError),
    *(MemoryError, OverflowError),  # a length that cannot be, and that a library wants to read at once
)
"""What libraries raise where a file is cut off or damaged, beside exceptions of their own."""

WITHOUT_WORDS = (KeyError, IndexError, TypeError, AttributeError, AssertionError, MemoryError)
"""Their texts speak of the program, not of the file."""


def damage_of(error: BaseException) -> str:
    """Return what is damaged, as the one who made it says, or in plain words where that says nothing."""
    text = "" if isinstance(error, WITHOUT_WORDS) else str(error)
    return text or "its records do not fit together"
