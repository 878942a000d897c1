"""A recording of messages, whatever its format: its channels, and its messages in the order of time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]

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

    def messages(self, wanted: Mapping[int, bool]) -> Iterator[Message]:
        """Yield the messages of channels; with their bytes where the mapping says so."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


@runtime_checkable
class Together(Protocol):
    """Messages that may be looked at together, or one by one, by time."""

    times_ns: Mapping[int, Times]
    """By channel, in the order of the file."""

    until_ns: int
    """The newest."""

    count: int

    def bodies(self, channel: int) -> tuple[NDArray[np.uint8], Times, Times]:
        """Return bytes, and where the data of each message of a channel begins and ends in them."""
        ...

    def __iter__(self) -> Iterator[Message]: ...


@runtime_checkable
class InStretches(Protocol):
    """A recording that hands on messages together where it can."""

    def stretches(self, wanted: Mapping[int, bool]) -> Iterator[Iterable[Message]]:
        """Yield all of `messages`, in their order, some of them Together."""
        ...


class Unreadable(Exception):
    """A file of which nothing can be read."""
