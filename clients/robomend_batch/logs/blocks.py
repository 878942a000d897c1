"""What a reader of logs yields: blocks of one log, in the order of the file.

    Rows      each sets a sensor (track.py)
    Shown     each is all that was known at its time, as bits of the log's sensors
    Restart   time begins again, here
    Place     so far the file was read, and from here it can be read on

A file may hold several logs, by its column `log`; a reader asks `Opened` for the words of each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from robomend.diagnosis.library import Codes
from robomend_batch.observing import Observing
from robomend_batch.problems import Problems
from robomend_batch.track import Rows, Times
from robomend_batch.words import Words


@dataclass(frozen=True, slots=True)
class Shown:
    """Codes over the sensors of the log's words; bits of sensors that are not named are 0."""

    time_ns: Times
    codes: Codes


@dataclass(frozen=True, slots=True)
class Advance:
    """Time passes until then, without news."""

    time_ns: int


@dataclass(frozen=True, slots=True)
class Restart:
    """A new segment begins."""

    time_ns: int


@dataclass(frozen=True, slots=True)
class Place:
    """How far a file was read: what its reader needs to go on from here. It holds until the reader does."""

    state: Any
    share: float  # of the file, from 0 to 1: for those who wait


class Block(NamedTuple):
    """Some of one log; `log` is the value of the column, "" without one."""

    log: str
    what: Rows | Shown | Advance | Restart | Place


@dataclass
class Opened:
    """What is open of a file while it is read."""

    words: Callable[[str], Words]
    """The words of one of its logs."""

    observing: Observing | None
    """The observers, for recorded messages."""

    by_header: bool
    """Whose clock: the one in the messages' headers, or the recorder's."""

    problems: Problems = field(default_factory=Problems)
    """Of the file as a whole."""

    ended_early: bool = False
    checked: bool = True
    """Whether damage of a recording would show."""

    begun: Any = None
    """The state of the Place to go on from; None: from the beginning."""


Blocks = Iterator[Block]
