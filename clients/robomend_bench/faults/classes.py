"""The classes of faults, their fixed shares, and how a trial is drawn from a class.

    class ── robot ──► the faults that may be planted ── seed ──► a scenario: what begins when, who watches

A robot takes part in the classes that have something to break on it. Within a class each of its robots is as
likely as the others, and within a robot each fault. docs/score.md has the table of shares: they are part of
the definition of the score and do not change.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from robomend_bench.faults.anatomy import Anatomy, Node
from robomend_bench.faults.condition import abnormal
from robomend_bench.faults.kinds import Fault, begun
from robomend_bench.faults.universe import Universe


@dataclass(frozen=True, slots=True)
class Planted:
    """A fault and when it begins."""

    fault: Fault
    after_s: float = 0.0  # after the first fault …
    follows_act: bool = False  # … or after the first act that reaches the robot
    spells_s: tuple[float, ...] = ()  # there for the first, gone for the second, there again, …


@dataclass(frozen=True, slots=True)
class Blind:
    """What is the matter with one observer."""

    topic: str
    how: str  # missing, dead, says-bad, says-good


@dataclass(frozen=True, slots=True)
class Reporting:
    """How the agents report; the defaults are robomend-agent's."""

    heartbeat_s: float = 1.0
    lifetime_s: float = 5.0
    late_s: float = 0.0  # each report is on its way for up to so long
    old: bool = False  # as before evidence had dates: no `since`, no `settle`, no `can`


@dataclass(frozen=True, slots=True)
class Scenario:
    """One trial: what begins when, and who watches."""

    planted: tuple[Planted, ...] = ()
    blind: Blind | None = None
    slowness: float = 1.0  # of every node's start and warming up
    # Component -> in what it differs from the robot's own.
    physics: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    times_known: bool = False  # whether the model says how long things take, and which drivers reconnect
    boots: bool = False  # whether the service sees the robot being switched on before its fault
    reporting: Reporting = Reporting()
    disturbed: str = ""  # a stretch whose disturbance begins with the fault
    stamped: str = ""  # a topic whose stamps, in whole seconds, are watched by their trend
    cut_off: str = ""  # the host that nobody hears while the fault is there
    longest_s: float = 0.0  # a boot or start of this robot may take so long

    @property
    def faults(self) -> tuple[Fault, ...]:
        return tuple(each.fault for each in self.planted)


Draw = Callable[[Anatomy, random.Random], Scenario]


@dataclass(frozen=True, slots=True)
class FaultClass:
    """One class; `faults` lists what it may plant on a robot, none: the robot takes no part."""

    name: str
    share: int
    does: str
    faults: Callable[[Anatomy], list[Fault]]
    draw: Draw | None = None  # None: one of `faults`, for good
    apart: bool = False  # an observer is at fault: counted apart
    to_service: str = ""  # what is done to the service meanwhile, which then is one of its own


# --- what can be broken ----------------------------------------------------------------------------------


def any_fault(anatomy: Anatomy) -> Iterator[Fault]:
    yield from relays(anatomy, "off")
    yield from devices_with(anatomy, "hung")
    yield from nodes_with(anatomy, "dead", "hung", "half-rate")
    yield from nodes_with(anatomy, "dead", "hung", loops=True)


def nodes_with(anatomy: Anatomy, *kinds: str, loops: bool = False) -> list[Fault]:
    return seen(
        anatomy,
        (
            Fault(name, kind)
            for name, node in anatomy.nodes.items()
            if (name in anatomy.loops) == loops and node.restartable and not node.protected
            for kind in kinds
        ),
    )


def seen(anatomy: Anatomy, faults: Iterator[Fault]) -> list[Fault]:
    """Leave out what nobody can see."""
    return [fault for fault in faults if abnormal(anatomy, begun(anatomy, fault))]


def is_feeder(anatomy: Anatomy, device: str) -> bool:
    return len(anatomy.fed[device]) > 1


def relays(anatomy: Anatomy, kind: str, *, feeders: bool = False) -> list[Fault]:
    return seen(
        anatomy,
        (
            Fault(name, kind)
            for name, device in anatomy.devices.items()
            if device.switchable and not device.protected and is_feeder(anatomy, name) == feeders
        ),
    )


def _can_be_cycled(anatomy: Anatomy, device: str) -> bool:
    """Whether its power can be cut by an act: its own, that of a feeder, or by a reset of its bus."""
    described = anatomy.devices[device]
    own = described.switchable and not described.protected
    return own or described.bus is not None or any(_can_be_cycled(anatomy, f) for f in described.fed_by)


def devices_with(anatomy: Anatomy, kind: str, *, feeders: bool = False, spare: bool = False) -> list[Fault]:
    return seen(
        anatomy,
        (
            Fault(name, kind)
            for name, device in anatomy.devices.items()
            if is_feeder(anatomy, name) == feeders
            and (device.spare is not None) == spare
            and (kind != "hung" or _can_be_cycled(anatomy, name))
            and not device.protected
        ),
    )


def _feeds(anatomy: Anatomy) -> list[Fault]:
    return [*relays(anatomy, "off", feeders=True), *devices_with(anatomy, "hung", feeders=True)]


def _dead_devices(anatomy: Anatomy) -> list[Fault]:
    stuck = [f for f in relays(anatomy, "off for ever") if anatomy.devices[f.component].spare is None]
    return [*devices_with(anatomy, "broken"), *stuck]


def _spares(anatomy: Anatomy) -> list[Fault]:
    return devices_with(anatomy, "broken", spare=True)


def _loops(anatomy: Anatomy) -> list[Fault]:
    """Return faults of nodes in loops, and of what feeds loops from outside."""
    found = nodes_with(anatomy, "dead", "hung", loops=True)
    outside = {
        anatomy.publisher[topic]
        for name in anatomy.loops
        for inputs in anatomy.nodes[name].publishes.values()
        for topic in inputs
        if topic in anatomy.publisher and anatomy.publisher[topic] not in anatomy.loops
    }
    return found + [fault for fault in nodes_with(anatomy, "dead", "hung") if fault.component in outside]


def followers(anatomy: Anatomy) -> list[tuple[Node, Node]]:
    """Return pairs of a node and one that needs what it publishes, neither of them in a loop."""
    return [
        (anatomy.nodes[anatomy.publisher[topic]], node)
        for node in anatomy.nodes.values()
        for inputs in node.publishes.values()
        for topic in inputs
        if topic in anatomy.publisher
        and {node.name, anatomy.publisher[topic]}.isdisjoint(anatomy.loops)
        and all(n.restartable and not n.protected for n in (node, anatomy.nodes[anatomy.publisher[topic]]))
    ]


# --- scenarios of more than one fault --------------------------------------------------------------------


def _one(faults: list[Fault], chance: random.Random) -> Scenario:
    return Scenario((Planted(chance.choice(faults)),))


def _two(anatomy: Anatomy, chance: random.Random) -> tuple[Fault, Fault]:
    """Draw two faults of which each shows something that the other does not."""
    faults = list(any_fault(anatomy))
    shows = {fault: abnormal(anatomy, begun(anatomy, fault)) for fault in faults}
    for _ in range(1000):
        first, second = chance.sample(faults, 2)
        if first.component != second.component and not (
            shows[first] <= shows[second] or shows[second] <= shows[first]
        ):
            return first, second
    raise ValueError("no two faults of this robot show different things")


def _double(anatomy: Anatomy, chance: random.Random) -> Scenario:
    first, second = _two(anatomy, chance)
    return Scenario((Planted(first), Planted(second)))


def _cascade(anatomy: Anatomy, chance: random.Random) -> Scenario:
    """A node hangs, and one that needs it crashes some time later."""
    first, second = chance.choice(followers(anatomy))
    later_s = chance.uniform(0.5, 2.0)
    return Scenario((Planted(Fault(first.name, "hung")), Planted(Fault(second.name, "dead"), later_s)))


def _mid_repair(anatomy: Anatomy, chance: random.Random) -> Scenario:
    first, second = _two(anatomy, chance)
    later_s = chance.uniform(0.1, 1.0)
    return Scenario((Planted(first), Planted(second, later_s, follows_act=True)))


def _intermittent(anatomy: Anatomy, chance: random.Random) -> Scenario:
    """A node hangs and comes back, again and again; restarted, it is well."""
    fault = chance.choice(nodes_with(anatomy, "hung"))
    spells_s = tuple(chance.uniform(2.5, 5.0) for _ in range(9))
    return Scenario((Planted(fault, spells_s=spells_s),))


def _slow(anatomy: Anatomy, chance: random.Random) -> Scenario:
    """A node dies or hangs on a robot whose nodes take their time to start."""
    return Scenario(
        (Planted(chance.choice(nodes_with(anatomy, "dead", "hung"))),), slowness=chance.uniform(6, 14)
    )


def _own_topic(anatomy: Anatomy, fault: Fault, chance: random.Random) -> str:
    topics = [t for t in anatomy.nodes[fault.component].publishes if anatomy.topics[t].observed]
    return chance.choice(topics)


def _talkers(anatomy: Anatomy, *kinds: str) -> list[Fault]:
    """Return faults of nodes outside loops, each with an observed topic of its own."""
    return [
        fault
        for fault in nodes_with(anatomy, *kinds)
        if any(anatomy.topics[topic].observed for topic in anatomy.nodes[fault.component].publishes)
    ]


def _blind(how: str) -> Draw:
    def draw(anatomy: Anatomy, chance: random.Random) -> Scenario:
        fault = chance.choice(_talkers(anatomy, "dead", "hung"))
        return Scenario((Planted(fault),), Blind(_own_topic(anatomy, fault, chance), how))

    return draw


def _lying(anatomy: Anatomy, chance: random.Random) -> Scenario:
    """One observer says the contrary: of a fault that it is none, or of a healthy topic that it is silent."""
    if chance.random() < 0.5:
        return _blind("says-good")(anatomy, chance)
    fault = chance.choice(_talkers(anatomy, "hung"))
    return Scenario((), Blind(_own_topic(anatomy, fault, chance), "says-bad"))


CLASSES: tuple[FaultClass, ...] = (
    FaultClass("off", 7, "a device's relay opens", lambda a: relays(a, "off")),
    FaultClass(
        "hung-device",
        8,
        "works again after a power cycle (its own, its supply's, or a reset of its bus)",
        lambda a: devices_with(a, "hung"),
    ),
    FaultClass("dead-device", 6, "nothing helps, or its relay sticks open", _dead_devices),
    FaultClass("dead-node", 12, "a process ends", lambda a: nodes_with(a, "dead")),
    FaultClass("hung-node", 13, "a process runs and is silent", lambda a: nodes_with(a, "hung")),
    FaultClass(
        "mute-successor",
        5,
        "a process ends or hangs; the next one or two started in its place run and are silent",
        lambda a: nodes_with(
            a, "dead, one mute successor", "dead, two mute successors", "hung, one mute successor"
        ),
    ),
    FaultClass(
        "wrong-successor",
        3,
        "the same; the next one publishes at half its rate",
        lambda a: nodes_with(a, "dead, one wrong successor", "hung, one wrong successor"),
    ),
    FaultClass("wrong-data", 7, "a node publishes at half its rate", lambda a: nodes_with(a, "half-rate")),
    FaultClass("feed", 5, "a supply is off or hung; the relays of what it feeds stay where they are", _feeds),
    FaultClass("spare", 4, "a device is dead that another can stand in for", _spares),
    FaultClass("loop", 7, "a node in a loop of topics, or one that feeds it, ends or hangs", _loops),
    FaultClass(
        "double",
        6,
        "two faults at once, each of which shows something that the other does not",
        lambda a: list(any_fault(a)),
        _double,
    ),
    FaultClass(
        "cascade",
        4,
        "a node hangs, and one that needs it ends 0.5 to 2 s later",
        lambda a: nodes_with(a, "hung") if followers(a) else [],
        _cascade,
    ),
    FaultClass(
        "for-ever",
        4,
        "a program that does not start any more (status 127), or is silent whenever it is started",
        lambda a: nodes_with(a, "dead, does not start", "dead, mute for ever", "hung, mute for ever"),
    ),
    FaultClass(
        "intermittent",
        3,
        "a node hangs and comes back by itself, in spells of 2.5 to 5 s, until it is restarted",
        lambda a: nodes_with(a, "hung"),
        _intermittent,
    ),
    FaultClass(
        "mid-repair",
        3,
        "a second fault 0.1 to 1 s after the first act",
        lambda a: list(any_fault(a)),
        _mid_repair,
    ),
    FaultClass(
        "slow-start",
        3,
        "a process ends or hangs; every node takes 6 to 14 times as long to start, as configured",
        lambda a: nodes_with(a, "dead", "hung"),
        _slow,
    ),
    FaultClass(
        "observer-missing",
        3,
        "a process ends or hangs, and nobody watches its topic",
        lambda a: _talkers(a, "dead", "hung"),
        _blind("missing"),
        apart=True,
    ),
    FaultClass(
        "observer-dead",
        3,
        "the same, and the topic's observer has fallen silent a moment before",
        lambda a: _talkers(a, "dead", "hung"),
        _blind("dead"),
        apart=True,
    ),
    FaultClass(
        "observer-lying",
        4,
        "an observer calls a silent topic ok, or a topic that is ok silent while nothing is broken",
        lambda a: _talkers(a, "dead", "hung"),
        _lying,
        apart=True,
    ),
)


def draw(described: FaultClass, anatomy: Anatomy, chance: random.Random) -> Scenario:
    """Return a scenario of a class on a robot that takes part in it."""
    if described.draw is not None:
        return described.draw(anatomy, chance)
    return _one(described.faults(anatomy), chance)


def universe_of(anatomy: Anatomy, classes: Iterable[FaultClass] = CLASSES) -> Universe:
    """Return what may be wrong with a robot, each fault as often as the classes plant it."""
    weights: dict[Fault, float] = {}
    for described in classes:
        if not described.apart:
            faults = described.faults(anatomy)
            for fault in faults:
                weights[fault] = weights.get(fault, 0.0) + described.share / len(faults)
    return Universe(anatomy, weights, frozenset(any_fault(anatomy)))
