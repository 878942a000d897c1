"""Recordings of random robots, healthy and with planted faults, by a generator that knows no robomend.

    robot(seed) ──► Robot: drivers, processing nodes, two values that go together, diagnostics
    write(…)    ──► drive.bag, and the faults that were planted in it

Nothing in it has the shape of what is learned: jitter is Student's t with three degrees of freedom, messages
get lost, a node pauses now and then for a lognormal while and then sends what it had queued or drops it, and
sometimes all of the computer stalls. Drivers send on a grid of time or after a wait, as real ones do.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

BEGIN_S = 1_700_000_000
FLOAT, FLOAT_MD5 = "std_msgs/msg/Float64", "fdb28210bfa9d7c91146260178d9a584"
ARRAY = "diagnostic_msgs/msg/DiagnosticArray"

KINDS = ("silent", "slow", "late", "hot", "frozen")
"""A node sends nothing; half; its answers late; a device's temperature is too high; a value stands still."""

QUIET_S = 90.0
"""Between faults, and before the first one."""


@dataclass(frozen=True)
class Source:
    """A node with its topic."""

    node: str
    topic: str
    rate_hz: float
    jitter_s: float
    pauses_h: float  # an hour
    pause_s: float  # usual length
    drops: bool  # what it could not send in a pause; otherwise it comes in a burst
    grid: bool  # sends by a clock, not after a wait
    asks: str | None = None  # the topic that it answers
    every: int = 1  # it answers one of so many
    takes_s: float = 0.0
    turn: bool = False  # its value is the robot's turning


@dataclass(frozen=True)
class Robot:
    """A robot."""

    name: str
    sources: tuple[Source, ...]
    device: str  # the node with diagnostics
    temperature: float


@dataclass(frozen=True)
class Planted:
    """A fault, in seconds from the beginning."""

    kind: str
    node: str
    start_s: float
    end_s: float


@dataclass
class _Turning:
    """How fast the robot turns: it starts and stops at random."""

    chance: random.Random
    until_s: float = 0.0
    speed: float = 0.0
    goal: float = field(default=0.0)
    at_s: float = 0.0

    def at(self, time_s: float) -> float:
        while time_s >= self.until_s:
            self.until_s += self.chance.uniform(1.5, 8.0)
            self.goal = self.chance.choice((0.0, 0.0, 1.0, -1.0)) * self.chance.uniform(0.3, 1.2)
        step_s, self.at_s = max(0.0, time_s - self.at_s), max(time_s, self.at_s)
        self.speed += (self.goal - self.speed) * (1 - math.exp(-step_s / 0.4))
        return self.speed


def robot(seed: int) -> Robot:
    """Return a random robot."""
    chance = random.Random(f"robot {seed}")
    rates = (4.0, 5.0, 8.0, 10.0, 12.5)

    def source(node: str, topic: str, rate_hz: float, **more: object) -> Source:
        return Source(
            node,
            topic,
            rate_hz,
            chance.uniform(0.01, 0.06) / rate_hz,
            chance.choice((0.0, 1.0, 4.0)),
            chance.uniform(0.2, 0.6),
            chance.random() < 0.5,
            chance.random() < 0.6,
            **more,  # type: ignore[arg-type]  # the fields that differ
        )

    drivers = [
        source("base_node", "odom", chance.choice((8.0, 10.0)), turn=True),
        source("imu_node", "gyro", chance.choice((10.0, 12.5)), turn=True),
    ]
    for number in range(chance.randint(1, 2)):
        drivers.append(source(f"sensor{number}_node", f"sensor{number}", chance.choice(rates)))
    answers = []
    for number in range(chance.randint(1, 2)):
        asked = chance.choice(drivers[2:])
        every = chance.choice((1, 1, 2))
        node = source(
            f"filter{number}_node",
            f"filtered{number}",
            asked.rate_hz / every,
            asks=asked.topic,
            every=every,
            takes_s=chance.uniform(0.05, 0.25) / asked.rate_hz,
        )
        answers.append(node)
    device = chance.choice(drivers).node
    return Robot(f"robot{seed}", (*drivers, *answers), device, chance.uniform(35, 55))


def faults(of: Robot, seed: int, length_s: float) -> list[Planted]:
    """Return faults one after another, each long enough to be seen by a person."""
    chance = random.Random(f"faults {seed}")
    answering = [one for one in of.sources if one.asks]
    found: list[Planted] = []
    at_s = QUIET_S + chance.uniform(0, 10)
    while True:
        kind = chance.choice(KINDS)
        node = {
            "silent": chance.choice(of.sources).node,
            "slow": chance.choice([one for one in of.sources if not one.asks]).node,
            "late": chance.choice(answering).node,
            "hot": of.device,
            "frozen": chance.choice(("base_node", "imu_node")),
        }[kind]
        end_s = at_s + chance.uniform(45, 75)
        if end_s + QUIET_S > length_s:
            return found
        found.append(Planted(kind, node, at_s, end_s))
        at_s = end_s + QUIET_S + chance.uniform(0, 10)


def write(file: Path, of: Robot, seed: int, length_s: float, planted: Sequence[Planted] = ()) -> Path:
    """Write a drive."""
    chance = random.Random(f"drive {seed}")
    stalls = _events(chance, 0.7, length_s, 0.4)
    turning = _Turning(random.Random(f"turning {seed}"))
    sent: dict[str, list[float]] = {}
    for source in of.sources:
        due = _due(source, sent, chance, length_s)
        due = [t for t in due if not _held(source, t, planted)]
        if source.asks is None and any(p.node == source.node and p.kind == "slow" for p in planted):
            due = [
                t for number, t in enumerate(due) if number % 2 or not _is("slow", source.node, t, planted)
            ]
        pauses = [*_events(chance, source.pauses_h, length_s, source.pause_s), *stalls]
        arrived = [late for t in due if (late := _after(t, pauses, source.drops)) is not None]
        sent[source.topic] = sorted(t for t in arrived if chance.random() >= 0.001)
    rows = [(time_s, number) for number, one in enumerate(of.sources) for time_s in sent[one.topic]]
    rows += [(float(second) + 0.003 * chance.random(), -1) for second in range(1, int(length_s))]
    rows.sort()
    stood: dict[str, float] = {}
    warm = 0.0
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(file) as writer:
        connections = [
            writer.add_connection(
                f"/{one.topic}", FLOAT, msgdef="float64 data\n", md5sum=FLOAT_MD5, callerid=f"/{one.node}"
            )
            for one in of.sources
        ]
        diagnostics = writer.add_connection("/diagnostics", ARRAY, typestore=store, callerid=f"/{of.device}")
        for time_s, number in rows:
            stamp_ns = BEGIN_S * 10**9 + round(time_s * 1e9)
            if number < 0:
                warm += 0.05 * (chance.gauss(0, 1) - 0.02 * warm)
                hot = 40.0 if _is("hot", of.device, time_s, planted) else 0.0
                status = _status(store, of, of.temperature + warm + hot, stamp_ns)
                writer.write(diagnostics, stamp_ns, store.serialize_ros1(status, ARRAY))
                continue
            source = of.sources[number]
            value = (turning.at(time_s) if source.turn else 0.0) + chance.gauss(0, 0.01)
            if _is("frozen", source.node, time_s, planted):
                value = stood.setdefault(source.node, value)
            else:
                stood.pop(source.node, None)
            writer.write(connections[number], stamp_ns, struct.pack("<d", value))
    return file


def _due(source: Source, sent: dict[str, list[float]], chance: random.Random, length_s: float) -> list[float]:
    """Return when a node would send, were there no pauses."""
    if source.asks is not None:
        asked = sent[source.asks][:: source.every]
        return [t + source.takes_s * chance.lognormvariate(0, 0.35) for t in asked]
    found: list[float] = []
    at_s, number = chance.random() / source.rate_hz, 0
    offset_s = at_s
    while at_s < length_s:
        found.append(at_s)
        number += 1
        jitter_s = source.jitter_s * _student(chance)
        grid_s = offset_s + number / source.rate_hz + jitter_s
        at_s = grid_s if source.grid else at_s + max(0.2 / source.rate_hz, 1 / source.rate_hz + jitter_s)
    return sorted(max(0.0, t) for t in found)


def _student(chance: random.Random) -> float:
    """Return a number of Student's t distribution with three degrees of freedom."""
    return chance.gauss(0, 1) / math.sqrt(chance.gammavariate(1.5, 2) / 3)


def _events(
    chance: random.Random, per_hour: float, length_s: float, usual_s: float
) -> list[tuple[float, float]]:
    """Return pauses: from, to."""
    found: list[tuple[float, float]] = []
    at_s = 0.0
    while per_hour and (at_s := at_s + chance.expovariate(per_hour / 3600)) < length_s:
        found.append((at_s, at_s + usual_s * chance.lognormvariate(0, 0.6)))
    return found


def _after(time_s: float, pauses: Sequence[tuple[float, float]], drops: bool) -> float | None:
    """Return when a message is sent that was due then; None: it is not."""
    for start_s, end_s in pauses:
        if start_s <= time_s < end_s:
            return None if drops else end_s + (time_s - start_s) * 0.01
    return time_s


def _is(kind: str, node: str, time_s: float, planted: Sequence[Planted]) -> bool:
    return any(p.kind == kind and p.node == node and p.start_s <= time_s < p.end_s for p in planted)


def _held(source: Source, time_s: float, planted: Sequence[Planted]) -> bool:
    """Return whether a fault keeps a message from being sent at all."""
    if _is("silent", source.node, time_s, planted):
        return True
    return _is("late", source.node, time_s, planted)


def _status(store: object, of: Robot, temperature: float, stamp_ns: int) -> object:
    t = store.types  # type: ignore[attr-defined]  # rosbags gives types that it makes
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    header = t["std_msgs/msg/Header"](
        seq=0, stamp=t["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds), frame_id=""
    )
    values = [
        t["diagnostic_msgs/msg/KeyValue"](key="temperature", value=f"{temperature:.2f}"),
        t["diagnostic_msgs/msg/KeyValue"](key="serial", value="4711"),
    ]
    status = t["diagnostic_msgs/msg/DiagnosticStatus"](
        level=0, name=f"{of.device}: device", message="", hardware_id="", values=values
    )
    return t["diagnostic_msgs/msg/DiagnosticArray"](header=header, status=[status])
