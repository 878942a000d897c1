"""A recording of messages, whatever its format: its channels, and its messages in the order of time."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]

SLICE = 4096
"""Messages of a stretch, where the recording has none."""

Message = tuple[int, int, bytes | None]
"""Time in nanoseconds, channel, and its bytes if they were asked for."""


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

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        """Yield the messages of channels.

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
        for message in messages:
            if by_time and message[0] != passed.last_ns:
                passed.last_ns, passed.count = message[0], 0
            passed.count += 1
            yield message


class Unreadable(Exception):
    """A file of which nothing can be read."""


DAMAGED = (
    *(OSError, ValueError, EOFError, struct.error, RuntimeError, AssertionError),
    *(KeyError, IndexError, TypeError, AttributeError),
    *(MemoryError, OverflowError),  # a length that cannot be, and that a library wants to read at once
)
"""What libraries raise where a file is cut off or damaged, beside exceptions of their own."""
