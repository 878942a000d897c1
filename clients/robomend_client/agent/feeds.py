"""Where the observers' samples come from: one feed for each origin, the `from:` of the agent's file.

    bus      the local bus: everything that `from:` does not send elsewhere
    agent    what the agent knows itself: `processes`, and what usage.py measures

A bridge (ROS 1, ROS 2, zenoh) is a feed, too. To add one, write a class of the shape of Feed and name it as
an entry point `robomend.feeds`; its section in the agent's file has the same name. It is loaded only when
an observer wants it, or, of those in SECTIONS, when its section is there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from robomend_client.paths import NotThere, at
from robomend_client.registry import Registry
from robomend_client.yaml_reader import Section

if TYPE_CHECKING:  # the agent's file is read before httpx is imported
    from robomend_client.agent.actions import Actions
    from robomend_client.agent.executors.base import Executors
    from robomend_client.agent.ring import Describe, Tap
    from robomend_client.clock import Clock
    from robomend_client.observers import Change, Verdict
    from robomend_client.rest.asynchronous import AsyncClient

AGENT, BUS = "agent", "bus"
OWN = ("processes", "host")
"""Sources that only the agent itself can have."""

EXTRAS = {name: f"pip install 'robomend-client[{name}]'" for name in ("ros1", "ros2", "zenoh")}
"""Feeds that are installed apart, and how."""

SECTIONS = (*EXTRAS, "medkit")
"""Feeds that are loaded when their section is there, wanted or not."""

NEEDS = {
    "ros1": ("rosbags",),
    "ros2": ("cyclonedds", "rosbags"),
    "zenoh": ("zenoh", "xxhash", "rosbags"),
}
"""The modules that come with it."""

Deliver = Callable[[str, object, "int | None"], None]
"""Called with source, value, and when the sample was made (None: now). With a Contact as the value: whether
the feed looks at that source; what does not come while it does not is no silence."""


class Feed(Protocol):
    """Hands the samples of one origin to the observers."""

    def __init__(self, section: Section, base: Path, sources: frozenset[str]) -> None:
        """Read its section of the agent's file; what is wrong in it is a ConfigError.

        Args:
            section: of the origin's name; the caller finishes it.
            base: the folder of the file.
            sources: what observers want of it: `scan`, `odom:twist.twist.linear.x`.
        """

    async def run(self, deliver: Deliver) -> None:
        """Deliver until cancelled; what goes wrong outside is waited out and logged, not raised."""


@runtime_checkable
class Reads(Protocol):
    """A feed that lets messages wait, and delivers them now and then."""

    def read_now(self) -> None:
        """Deliver what has come by now: called each beat, and before anything is judged."""


@dataclass(frozen=True)
class AgentParts:
    """What a bridge may use of the agent that it is a part of."""

    robot: str
    agent: str
    state_dir: Path
    client: AsyncClient
    clock: Clock
    executors: Executors
    actions: Actions
    standing: Callable[[], Sequence[Verdict]]  # what the agent's observers hold now
    heartbeat_s: float
    buffer_bytes: int
    tap: Callable[[Describe], Tap] | None = None
    """Returns what each message is handed to, as it came; None: nobody keeps any."""
    keeps_all: bool = False
    """Whether it wants messages of any size; else those that are no burden."""


@runtime_checkable
class Bridge(Feed, Protocol):
    """A feed that also tells the robot what the agent and the service know, and lets it act."""

    def attach(self, parts: AgentParts) -> None:
        """Called once, before `run`."""

    def changed(self, changes: Sequence[Change]) -> None:
        """The agent's observers have found this."""


class MissingExtra(Exception):
    """A part that is installed apart is not; the message says how to install it."""


class UnknownFeed(LookupError):
    """No feed has this name."""


class BrokenFeed(Exception):
    """The code of a feed cannot be loaded."""


FEEDS = Registry[Callable[..., Feed]](
    "origin of samples",
    "robomend.feeds",
    {
        "ros1": "robomend_client.bridges.ros1.feed:Ros1",
        "ros2": "robomend_client.bridges.ros2.feed:Ros2",
        "zenoh": "robomend_client.bridges.zenoh.feed:Zenoh",
        "medkit": "robomend_client.bridges.medkit.feed:Medkit",
        "board": "robomend_client.bridges.board:ServiceBoard",
    },
    unknown=UnknownFeed,
    broken=BrokenFeed,
    beside=(BUS,),
)


def load_feed(origin: str) -> Callable[..., Feed]:
    """Return the class of a feed.

    Raises:
        MissingExtra: it is installed apart.
        UnknownFeed, BrokenFeed: there is none of this name, or it cannot be imported.
    """
    if origin in EXTRAS and (
        origin not in FEEDS.names() or any(find_spec(module) is None for module in NEEDS.get(origin, ()))
    ):
        raise MissingExtra(f"{origin} needs what is installed with: {EXTRAS[origin]}")
    return FEEDS.load(origin)


def split(source: str) -> tuple[str, str]:
    """Return topic and field of a source; without one, the field is empty."""
    topic, _, field = source.partition(":")
    return topic.removeprefix("/"), field


def is_own(source: str) -> bool:
    """Return whether only the agent itself can have a source."""
    return split(source)[0] in OWN


class Samples:
    """Makes samples of messages, for the observers that want the topic, or fields of it."""

    def __init__(
        self, sources: frozenset[str], deliver: Deliver, on_problem: Callable[[str, str], None]
    ) -> None:
        """`on_problem` is told of each source that a message does not have, with the reason."""
        self._deliver = deliver
        self._on_problem = on_problem
        self._wanted: dict[str, list[tuple[str, str]]] = {}
        for source in sorted(sources):
            topic, field = split(source)
            self._wanted.setdefault(topic, []).append((source, field))

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that somebody wants."""
        return tuple(self._wanted)

    def message(
        self,
        topic: str,
        data: object = None,
        time_ns: int | None = None,
        fields: Mapping[str, Any] | None = None,
    ) -> None:
        """A message came in; `fields` are those that were taken out of it already."""
        for source, field in self._wanted.get(topic.removeprefix("/"), ()):
            if not field:
                self._deliver(source, data, time_ns)
            elif fields is not None and field in fields:
                self._deliver(source, fields[field], time_ns)
            else:
                try:
                    value = at(data, field)
                except NotThere as error:
                    self._on_problem(source, str(error))
                else:
                    self._deliver(source, value, time_ns)
