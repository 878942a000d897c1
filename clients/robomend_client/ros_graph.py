"""A ROS graph as a value, and what was heard on it, wherever both are known from.

    a live graph ──┐
    a recording  ──┼──► Heard: nodes, topics, rates ──► a first model (robomend.model.from_graph)
    launch files ──┘

A source says what it knows and leaves out the rest.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any

Table = Mapping[str, frozenset[str]]
"""Name of a topic or service -> names of nodes."""

MOST_STAMPS = 2048
"""Of a topic: the newest."""

EACH_START = re.compile(r"_(?:\d{1,7}_)?\d{12,20}\Z|(?<=static_transform_publisher)_\w{8,20}\Z")
"""What a name ends with that is another one at each start: the process and the time, or a random number."""

GOALS_END = "/_action/status"
"""How the topic ends on which an action server of ROS 2 tells of its goals."""


@dataclass(frozen=True)
class RosGraph:
    """All names are as ROS has them, with their slashes."""

    publishers: Table = field(default_factory=dict)
    subscribers: Table = field(default_factory=dict)
    services: Table = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)  # of topics, as pkg/Name
    rates_hz: Mapping[str, float] = field(default_factory=dict)  # of topics, where they were measured
    actions: Table = field(default_factory=dict)  # action servers of ROS 2 -> nodes
    clients: Table = field(default_factory=dict)  # services of ROS 2 -> nodes that may call them

    @property
    def nodes(self) -> frozenset[str]:
        """All nodes that do any of it."""
        return frozenset(
            node
            for table in (self.publishers, self.subscribers, self.services)
            for nodes in table.values()
            for node in nodes
        )

    def renamed(self) -> RosGraph:
        """Return it with nodes whose names change at each start by what stays of their names."""

        def table(found: Table) -> Table:
            return {name: frozenset(map(lasting_name, nodes)) for name, nodes in found.items()}

        return replace(
            self,
            publishers=table(self.publishers),
            subscribers=table(self.subscribers),
            services=table(self.services),
            actions=table(self.actions),
            clients=table(self.clients),
        )


def lasting_name(node: str) -> str:
    """Return a node's name without what is another at each start, as of anonymous nodes."""
    return EACH_START.sub("", node)


def logged_by(logger: str) -> str:
    """Return the lasting name of the node that a line of a log names: robot1.camera is /robot1/camera."""
    return lasting_name("/" + logger.strip("/").replace(".", "/"))


@dataclass(frozen=True)
class HeardTopic:
    """What came of a topic while somebody listened. Times are of one clock, in nanoseconds."""

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_s: float = 0.0  # between two messages
    stamps: tuple[int, ...] = ()  # of the newest messages
    latched: bool = False  # its publishers keep the last message for those who come later
    wait_s: float = 0.0  # from the beginning of a recording to its first message there, at most

    @property
    def span_s(self) -> float:
        """From the first to the last message."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def rate_hz(self) -> float:
        """Messages per second; 0 where there is none to speak of."""
        return (self.count - 1) / self.span_s if self.count > 1 and self.span_s > 0 else 0.0

    @property
    def usual_s(self) -> float:
        """The median interval; 0 where there is none."""
        gaps = [late - early for early, late in zip(self.stamps, self.stamps[1:], strict=False)]
        return median(gaps) / 1e9 if gaps else 0.0


@dataclass(frozen=True)
class UsualRate:
    """How a topic came to an agent while all was well."""

    window: int  # messages that a rate is of
    count: int = 0  # messages
    seconds: float = 0.0
    longest_s: float = 0.0  # between two messages
    slowest_hz: float = 0.0  # of windows; 0: there was none
    fastest_hz: float = 0.0


class Ear:
    """Takes in the messages of one topic; of their times no more than MOST_STAMPS are kept."""

    def __init__(self, stamps: Iterable[int] = ()) -> None:
        self.forget()
        for time_ns in stamps:
            self.message(time_ns)

    def forget(self) -> None:
        """Begin anew."""
        self.count = 0
        self._first_ns = self._last_ns = self._longest_ns = 0
        self._stamps: deque[int] = deque(maxlen=MOST_STAMPS)

    def message(self, time_ns: int) -> None:
        """A message came; one from before the newest counts as having come with it."""
        if self.count:
            time_ns = max(time_ns, self._last_ns)
            self._longest_ns = max(self._longest_ns, time_ns - self._last_ns)
        else:
            self._first_ns = time_ns
        self.count += 1
        self._last_ns = time_ns
        self._stamps.append(time_ns)

    def heard(self, latched: bool = False) -> HeardTopic:
        """Return what came so far."""
        return HeardTopic(
            self.count, self._first_ns, self._last_ns, self._longest_ns / 1e9, tuple(self._stamps), latched
        )


@dataclass(frozen=True)
class HeardStatus:
    """A status of /diagnostics."""

    levels: frozenset[int]  # 0: OK, 1: WARN, 2: ERROR, 3: STALE
    publishers: frozenset[str]
    topic: HeardTopic = HeardTopic()  # when it came


@dataclass(frozen=True)
class HeardDevice:
    """A device that something speaks of."""

    source: str  # where it is from, for people
    node: str = ""  # that drives it, as far as that is known


@dataclass(frozen=True, slots=True)
class SteadyTopic:
    """A topic that came steadily, and what its observer is told of it."""

    rate_hz: float
    tolerance_hz: float
    above_hz: float
    window: int  # messages
    settle: int  # intervals
    silence_s: float
    pause_s: float | None
    why: tuple[str, ...]  # what the numbers rest on
    first_s: float | None = None  # so long it may take to begin, where that was seen
    held_s: float | None = None  # what was held up for so long, and comes at once, is no wrong rate


@dataclass(frozen=True)
class Learned:
    """What long recordings tell beside: then rates, statuses and inputs are not told by plain rules."""

    rates: Mapping[str, SteadyTopic | str] = field(default_factory=dict)  # topic -> its rate, or why none
    answers: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # topic -> input -> evidence
    observers: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # name -> keys, as YAML has them
    evidence: Mapping[str, Sequence[str]] = field(default_factory=dict)  # of each observer
    blamed: Mapping[str, str] = field(default_factory=dict)  # property of an observer -> node
    values: Mapping[str, tuple[str, str]] = field(default_factory=dict)  # name -> topic, field
    related: Sequence[tuple[str, str]] = ()  # values whose trends are alike
    left_out: Sequence[tuple[str, str]] = ()  # what is not observed, and why


@dataclass(frozen=True)
class Heard:
    """What was heard of a robot. A graph alone is one, too: then nobody listened (`seconds` is 0)."""

    graph: RosGraph
    source: str  # where it is from, for people
    seconds: float = 0.0  # for how long somebody listened
    ended_ns: int = 0  # when that was over
    topics: Mapping[str, HeardTopic] = field(default_factory=dict)
    statuses: Mapping[str, HeardStatus] = field(default_factory=dict)
    actions: Mapping[str, str] = field(default_factory=dict)  # name -> the node that serves it
    lifecycle: Mapping[str, str] = field(default_factory=dict)  # node -> its state as it was said last, or ""
    errors: Mapping[str, int] | None = field(
        default_factory=dict
    )  # node -> lines from ERROR on; None: no logs
    moving: Mapping[str, str] = field(default_factory=dict)  # topic -> a field that was never twice the same
    gone: frozenset[str] = frozenset()  # nodes that ended meanwhile, or do not run although they are listed
    since_ns: Mapping[str, int] = field(default_factory=dict)  # node -> when it was seen first
    remarks: tuple[str, ...] = ()  # what else people should know
    origin: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # ros1 or ros2, with its keys
    devices: Mapping[str, HeardDevice] = field(default_factory=dict)  # by what it calls itself
    usual: Mapping[str, UsualRate] = field(default_factory=dict)  # topic, without its slash -> since then
    launched: Mapping[str, str] = field(
        default_factory=dict
    )  # nodes of launch files -> what they say of each
    learned: Learned | None = None  # from long recordings
    unnamed: frozenset[str] = frozenset()  # nodes that stand for publishers of which nobody knows the name

    def within(self, namespace: str) -> Heard:
        """Return what was heard of the nodes in a namespace."""
        inside = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"

        def table(found: Table) -> Table:
            kept = {
                name: frozenset(n for n in nodes if (name if n in self.unnamed else n).startswith(inside))
                for name, nodes in found.items()
            }
            return {name: nodes for name, nodes in kept.items() if nodes}

        graph = replace(
            self.graph,
            publishers=table(self.graph.publishers),
            subscribers=table(self.graph.subscribers),
            services=table(self.graph.services),
            clients=table(self.graph.clients),
        )
        statuses = {
            name: status
            for name, status in self.statuses.items()
            if any(node.startswith(inside) for node in status.publishers)
        }
        actions = {name: node for name, node in self.actions.items() if node.startswith(inside)}
        lifecycle = {node: state for node, state in self.lifecycle.items() if node.startswith(inside)}
        return replace(self, graph=graph, statuses=statuses, actions=actions, lifecycle=lifecycle)
