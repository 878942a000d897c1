"""What a simulated robot is made of, in truth: devices, nodes, topics, and what each physically needs.

The model (what robomend is told) says most of it; the physics document beside it says the rest, which no
model holds: how long things take, who stands in for whom, which topics nobody watches. Both are read here,
and from then on the bench asks the anatomy only. Times are seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from robomend_client.literals import Atom, Literal, holds, parse_atom

SILENCE_PERIODS = 2.5
"""A node stops publishing when an input has been silent for so many of its periods."""


@dataclass(frozen=True, slots=True)
class Device:
    """A piece of hardware."""

    name: str
    channel: int | None = None  # of the power board; None: nothing switches it
    fed_by: tuple[str, ...] = ()
    host: str | None = None
    protected: bool = False
    boot_s: float = 0.4  # from power to working
    spare: str | None = None  # the device that can stand in for it
    bus: str | None = None  # a bus that can be reset
    links: str = ""  # a host that is heard by it

    @property
    def switchable(self) -> bool:
        return self.channel is not None


@dataclass(frozen=True, slots=True)
class Node:
    """A process; `publishes` is topic -> the topics without which it does not publish that one."""

    name: str
    drives: tuple[str, ...] = ()
    publishes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    tied_to: tuple[str, ...] = ()  # nodes after whose start it must be restarted
    host: str | None = None
    restartable: bool = True
    protected: bool = False
    start_s: float = 0.15  # from the order to the evidence that it runs
    stop_s: float = 0.1
    warm_s: float = 0.3  # from running to the first message
    kicks: bool = False  # starved of inputs, it still publishes now and then: this is what starts a loop
    reconnects: bool = False  # when its device has been without power, it is with it again by itself
    hasty: bool = False  # started before its device has booted, it holds a dead connection


@dataclass(frozen=True, slots=True)
class Topic:
    """A stream of messages."""

    name: str
    rate_hz: float = 10.0
    tolerance_hz: float = 2.0
    observed: bool = True
    latched: bool = False  # one message at its publisher's start, which is kept for who comes later
    values: Mapping[str, str | float] = field(default_factory=dict)
    """Field -> what it does: `wave`, `clock`, `whole seconds`, `status of DEVICE`, or a number."""

    @property
    def period_s(self) -> float:
        return 1.0 / self.rate_hz


@dataclass(frozen=True, slots=True)
class Aspect:
    """What is observed beside rates and processes, and on what in the truth it depends."""

    atom: Atom
    observer: Mapping[str, Any]  # as the agent's file says it
    host: str | None = None
    flows: tuple[str, ...] = ()  # topics without which it is unknown
    still: tuple[str, ...] = ()  # topics; it is bad where the value of one, and not of all, stands still
    silent: tuple[str, ...] = ()  # topics; it is bad where one of them is silent
    status: str = ""  # a device; it is bad while that complains


@dataclass(frozen=True)
class Anatomy:
    """All of it."""

    devices: Mapping[str, Device]
    nodes: Mapping[str, Node]
    topics: Mapping[str, Topic]
    aspects: tuple[Aspect, ...] = ()
    power: str = "board"  # who switches the channels: the emulated "board", or the host's "agent"
    channels: int = 10

    @cached_property
    def publisher(self) -> Mapping[str, str]:
        """Topic -> the node that publishes it; topics from outside are not in it."""
        return {topic: node.name for node in self.nodes.values() for topic in node.publishes}

    @cached_property
    def consumers(self) -> Mapping[str, tuple[str, ...]]:
        """Topic -> the topics that need it."""
        found: dict[str, list[str]] = {}
        for node in self.nodes.values():
            for topic, inputs in node.publishes.items():
                for needed in inputs:
                    found.setdefault(needed, []).append(topic)
        return {topic: tuple(needing) for topic, needing in found.items()}

    @cached_property
    def drivers(self) -> Mapping[str, tuple[str, ...]]:
        """Device -> the nodes that drive it."""
        return {
            device: tuple(node.name for node in self.nodes.values() if device in node.drives)
            for device in self.devices
        }

    @cached_property
    def fed(self) -> Mapping[str, frozenset[str]]:
        """Device -> what loses its power with it, itself included."""
        return {device: frozenset(self._fed(device)) for device in self.devices}

    def _fed(self, device: str) -> Iterable[str]:
        yield device
        for other in self.devices.values():
            if device in other.fed_by:
                yield from self._fed(other.name)

    @cached_property
    def tied(self) -> Mapping[str, tuple[str, ...]]:
        """Node -> the nodes that must be restarted after it."""
        return {
            name: tuple(node.name for node in self.nodes.values() if name in node.tied_to)
            for name in self.nodes
        }

    @cached_property
    def hosts(self) -> tuple[str | None, ...]:
        """The computers, each with an agent; one without a name where the model has no hosts."""
        named = {node.host for node in self.nodes.values() if node.host}
        named |= {device.host for device in self.devices.values() if device.host}
        return tuple(sorted(named)) or (None,)

    def host_of(self, topic: str) -> str | None:
        """Return the computer whose agent watches a topic."""
        node = self.publisher.get(topic)
        host = None if node is None else self.nodes[node].host
        return host if host is not None else self.hosts[0]

    @cached_property
    def healthy(self) -> frozenset[Literal]:
        """What is observed of the robot when all is well, long after its boot."""
        return frozenset(
            (
                *(holds("on", device.name) for device in self.devices.values() if device.switchable),
                *(holds("running", node) for node in self.nodes),
                *(holds("ok", topic.name) for topic in self.topics.values() if topic.observed),
                *(Literal(aspect.atom, True) for aspect in self.aspects),
            )
        )

    @cached_property
    def loops(self) -> frozenset[str]:
        """The nodes that publish a topic which, in a circle, needs itself."""
        found = set()
        for topic, node in self.publisher.items():
            seen, waiting = set(), list(self.consumers.get(topic, ()))
            while waiting:
                following = waiting.pop()
                if following not in seen:
                    seen.add(following)
                    waiting += self.consumers.get(following, ())
            if topic in seen:
                found.add(node)
        return frozenset(found)


def read_anatomy(model: Mapping[str, Any], physics: Mapping[str, Any]) -> Anatomy:
    """Return the anatomy of a robot from its model and its physics document, both parsed.

    Raises:
        KeyError: the physics speak of something that the model does not have.
    """
    devices, nodes = physics.get("devices", {}), physics.get("nodes", {})
    unobserved, more = set(physics.get("unobserved", ())), physics.get("topics", {})
    topics = {
        name: _topic(name, value or {}, unobserved, more.get(name, {}))
        for name, value in model.get("topics", {}).items()
    }
    for value in model["nodes"].values():
        for name in value.get("publishes", {}):
            topics.setdefault(name, _topic(name, {}, unobserved, more.get(name, {})))
    parts = Anatomy(
        devices={
            name: _device(name, value or {}, devices.get(name, {}))
            for name, value in model.get("hardware", {}).items()
        },
        nodes={
            name: _node(name, value or {}, {**physics.get("every_node", {}), **nodes.get(name, {})})
            for name, value in model["nodes"].items()
        },
        topics=topics,
        aspects=tuple(_aspect(name, value) for name, value in physics.get("aspects", {}).items()),
        power=physics.get("power", "board"),
        channels=model.get("channels", 10),
    )
    for name in (*devices, *nodes, *unobserved, *more):
        if name not in parts.devices and name not in parts.nodes and name not in parts.topics:
            raise KeyError(f"physics of {name!r}, which the model does not have")
    return parts


def _topic(name: str, value: Mapping[str, Any], unobserved: set[str], physics: Mapping[str, Any]) -> Topic:
    rate = float(value.get("rate_hz", 10.0))
    tolerance = float(value.get("tolerance_hz", rate / 5))
    return Topic(name, rate, tolerance, name not in unobserved, **physics)


def _aspect(name: str, value: Mapping[str, Any]) -> Aspect:
    lists = {key: tuple(value.get(key, ())) for key in ("flows", "still", "silent")}
    return Aspect(
        parse_atom(name), value["observer"], value.get("host"), status=value.get("status", ""), **lists
    )


def _device(name: str, value: Mapping[str, Any], physics: Mapping[str, Any]) -> Device:
    return Device(
        name,
        channel=value.get("channel"),
        fed_by=tuple(value.get("fed_by", ())),
        host=value.get("host"),
        protected=value.get("protected", False),
        **physics,
    )


def _node(name: str, value: Mapping[str, Any], physics: Mapping[str, Any]) -> Node:
    drives = tuple(value.get("drives", ()))
    published = value.get("publishes", {})
    needs = bool(not drives or value.get("inputs_matter"))
    return Node(
        name,
        drives=drives,
        publishes={topic: tuple(inputs) if needs else () for topic, inputs in published.items()},
        tied_to=tuple(value.get("tied_to", ())),
        host=value.get("host"),
        restartable=value.get("restartable", True),
        protected=value.get("protected", False),
        **physics,
    )
