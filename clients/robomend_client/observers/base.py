"""The one shape of all observers: values with their times go in, literals come out. No clocks, no sockets, no
threads.

    feed(source, time_ns, value)   a message of a topic, the table of processes, …; `sources` says which
    check(now_ns)                  the literals that hold now; an atom that is not among them is unknown

So the same observer runs on a robot (fed by the agent), in a bridge (fed by ROS) and over a log (fed from a
bag, with the bag's times). Times are integer nanoseconds of any one clock that does not go back; an observer
never asks for the time itself.

To add an observer, write one small file with a class of this shape (and its parameters as a frozen dataclass
whose defaults are the published ones), and name it in observers/__init__.py. For the agent to make it from
its configuration, add a section to agent/config.py.
"""

from __future__ import annotations

from typing import Protocol

from robomend_client.literals import Literal

SECOND = 1_000_000_000


def ns(seconds: float) -> int:
    """Return seconds as integer nanoseconds."""
    return round(seconds * SECOND)


class Observer(Protocol):
    """One observer of one aspect of the robot."""

    @property
    def sources(self) -> frozenset[str]:
        """What it wants to be fed with."""
        ...

    @property
    def period_ns(self) -> int:
        """How often it wants to be checked."""
        ...

    def feed(self, source: str, time_ns: int, value: object) -> None:
        """Take in one value. Times that go back count as the newest time so far."""
        ...

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        """Return what holds at `now_ns`, which is no earlier than any time it was fed with."""
        ...
