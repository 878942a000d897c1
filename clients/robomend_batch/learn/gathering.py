"""What healthy logs hold: the times of every topic, the numbers of some of their fields, the diagnostics.

One pass over each log. Times are kept (8 bytes a message, MOST_TIMES of a topic), of values the mean of each
TICK_NS, and of a field no more than MOST_VALUES.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from robomend.model.from_graph import is_plumbing
from robomend_batch.learn.stretches import Stretch, Times, cut
from robomend_batch.logs.compressed import plain_log
from robomend_batch.logs.fields import compile_field, plain
from robomend_batch.logs.kinds import RECORDINGS, kind_of
from robomend_batch.logs.recorded import HOLE, Channel, Recording, Unreadable
from robomend_batch.logs.wanted import STATUSES, WHOLE, store_of
from robomend_batch.problems import LogRefused, Problems
from robomend_client.counts import counted, first_few
from robomend_client.observers.base import SECOND
from robomend_client.observers.diagnostic import number_of
from robomend_client.observers.rosout import reaches
from robomend_client.ros_graph import Ear, Heard, HeardStatus, RosGraph, lasting_name, logged_by

MOST_TIMES = 5_000_000
MOST_VALUES = 20_000
MOST_STATUSES = 200
MOST_NODES = 1000
MOST_FIELDS = 12
"""Of a type: the first ones."""

TICK_NS = SECOND // 5
"""That of the observer that compares two values."""

DIAGNOSTICS, STATUS = WHOLE["diagnostics"]

REPLAYED = "/play_"
"""How a node is called that plays a recording, and is recorded anew."""

NO_GRAPH = RosGraph()

UNNAMED = "/publisher_of_"
"""The node of a topic whose publisher no log names; the topic follows."""

LOGS = ("rosgraph_msgs/msg/Log", "rcl_interfaces/msg/Log")
"""Types of /rosout."""

DISCOVERY = "ros_discovery_info"
"""Of ROS 2: which nodes there are. What they publish it says by numbers that no recording explains."""

ASIDE = ("header", "covariance", "orientation")
"""Fields that are no values whose trends one would compare: quaternions wrap, covariances stand."""


@dataclass
class Series:
    """A number over time, by log."""

    times: dict[int, array[int]] = field(default_factory=lambda: defaultdict(lambda: array("q")))
    values: dict[int, array[float]] = field(default_factory=lambda: defaultdict(lambda: array("d")))
    count: int = 0

    def add(self, log: int, time_ns: int, value: float) -> None:
        """Take in one; beyond MOST_VALUES they are left out."""
        if self.count < MOST_VALUES and value - value == 0:  # neither NaN nor infinite
            self.times[log].append(time_ns)
            self.values[log].append(value)
            self.count += 1

    def pieces(self, stretches: Sequence[Stretch]) -> list[tuple[Times, NDArray[np.float64]]]:
        """Return times and values, stretch by stretch."""
        found = []
        for stretch in stretches:
            times = np.array(self.times.get(stretch.log, ()), dtype=np.int64)
            values = np.array(self.values.get(stretch.log, ()), dtype=np.float64)
            part = stretch.of(times)
            if part.stop > part.start:
                found.append((times[part], values[part]))
        return found


@dataclass
class Means:
    """A number, of which the means of ticks are kept."""

    series: Series
    extract: Callable[[bytes], Any]
    tick: int = 0
    total: float = 0.0
    count: int = 0

    def add(self, log: int, time_ns: int, value: float) -> None:
        """Take in one."""
        tick = time_ns // TICK_NS
        if tick != self.tick:
            self.end(log)
            self.tick = tick
        self.total += value
        self.count += 1

    def end(self, log: int) -> None:
        """The tick is over."""
        if self.count:
            self.series.add(log, self.tick * TICK_NS, self.total / self.count)
        self.total, self.count = 0.0, 0


@dataclass
class Status:
    """A status of a topic of diagnostics."""

    publishers: set[str] = field(default_factory=set)
    levels: Series = field(default_factory=Series)
    numbers: dict[str, Series] = field(default_factory=lambda: defaultdict(Series))


@dataclass
class Topic:
    """A topic of the logs."""

    name: str
    types: set[str] = field(default_factory=set)
    publishers: set[str] = field(default_factory=set)  # empty: no recording says
    times: dict[int, list[Times]] = field(default_factory=lambda: defaultdict(list))
    fields: dict[str, Series] = field(default_factory=dict)

    def of_log(self, log: int) -> Times:
        """Return its times in a log, sorted."""
        parts = self.times.get(log)
        return np.sort(np.concatenate(parts), kind="stable") if parts else np.zeros(0, dtype=np.int64)

    def pieces(self, stretches: Sequence[Stretch]) -> list[Times]:
        """Return its times, stretch by stretch; none where it was not heard."""
        logs = {log: self.of_log(log) for log in {stretch.log for stretch in stretches}}
        return [logs[stretch.log][stretch.of(logs[stretch.log])] for stretch in stretches]

    @property
    def count(self) -> int:
        """How many messages there were."""
        return sum(len(part) for parts in self.times.values() for part in parts)


@dataclass
class Gathered:
    """All that is learned from."""

    topics: dict[str, Topic] = field(default_factory=dict)
    statuses: dict[tuple[str, str], Status] = field(default_factory=dict)  # by topic and name
    errors: Counter[str] | None = None  # lines of nodes' logs from ERROR on; None: no logs were recorded
    nodes: set[str] = field(default_factory=set)  # that DISCOVERY names, with their slashes
    names: list[str] = field(default_factory=list)  # of the logs
    spans_ns: list[tuple[int, int]] = field(default_factory=list)
    problems: Problems = field(default_factory=Problems)
    stretches: list[Stretch] = field(default_factory=list)

    @property
    def learned(self) -> list[Stretch]:
        """What is learned from."""
        return [stretch for stretch in self.stretches if not stretch.held_back]

    @property
    def held_back(self) -> list[Stretch]:
        """What is held back."""
        return [stretch for stretch in self.stretches if stretch.held_back]

    @property
    def whole(self) -> list[Stretch]:
        """Each log from its beginning to its end."""
        return [Stretch(log, start, end + 1, False) for log, (start, end) in enumerate(self.spans_ns)]

    def without(self, logs: Collection[int] = ()) -> Gathered:
        """Return the same with these logs held back, and nothing else."""
        parts = [replace(stretch, held_back=stretch.log in logs) for stretch in self.stretches]
        return replace(self, stretches=parts)


def gather(names: Sequence[str], on_log: Callable[[str], None] = lambda name: None) -> Gathered:
    """Read logs; those that cannot be read are among the problems."""
    found = Gathered()
    for name in names:
        try:
            with open_log(Path(name)) as recording:
                _Reader(found, recording, Path(name)).read()
        except LogRefused as error:
            found.problems.add(name, error.reason, bad=True)
            continue
        on_log(name)
    found.stretches = cut(found.spans_ns)
    return found


def heard_of(found: Gathered, live: RosGraph = NO_GRAPH) -> Heard:
    """Return what logs hold as if somebody had listened, one log after the other, a moment apart.

    Args:
        live: of the running robot: who publishes what the logs name nobody for, and who listens.
    """
    begins: list[int] = []
    end_ns = 0
    for start_ns, stop_ns in found.spans_ns:
        begins.append(end_ns - start_ns)
        end_ns += stop_ns - start_ns
    topics, publishers = {}, {}
    unnamed: set[str] = set()
    for name, topic in found.topics.items():
        ear = Ear()
        for log, ahead_ns in enumerate(begins):
            for time_ns in topic.of_log(log).tolist():
                ear.message(time_ns + ahead_ns)
        topics[f"/{name}"] = replace(ear.heard(), wait_s=first_s(found, name))
        named = frozenset(node for node in topic.publishers if not f"{node}_".startswith(REPLAYED))
        named = named or live.publishers.get(f"/{name}", frozenset())
        if not named and not is_plumbing(f"/{name}"):
            named = frozenset({UNNAMED + name})
            unnamed |= named
        publishers[f"/{name}"] = frozenset(map(lasting_name, named))
    own = frozenset(node for nodes in publishers.values() for node in nodes)  # the recorder listens to all
    graph = RosGraph(
        publishers,
        {topic: live.subscribers.get(topic, frozenset()) & own for topic in publishers},
        types={
            f"/{name}": sorted(topic.types)[0].replace("/msg/", "/") for name, topic in found.topics.items()
        },
    )
    statuses = {
        name: HeardStatus(
            frozenset(int(level) for levels in status.levels.values.values() for level in levels),
            frozenset(map(lasting_name, status.publishers)),
            Ear(
                sorted(
                    time_ns + begins[log] for log, times in status.levels.times.items() for time_ns in times
                )
            ).heard(),
        )
        for (_, name), status in found.statuses.items()
    }
    names = first_few([Path(name).name for name in found.names], 3)
    others = ", ".join(sorted(node.removeprefix("/") for node in found.nodes))
    origin = "ros1" if any(".bag" in Path(name).suffixes for name in found.names) else "ros2"
    return Heard(
        graph,
        f"{counted(len(found.names), 'recording')} of a healthy robot: {names}",
        end_ns / SECOND,
        end_ns,
        topics,
        statuses,
        errors=None if found.errors is None else dict(found.errors),
        unnamed=frozenset(unnamed),
        remarks=(f"nodes that the recordings name, without their topics: {others}",)
        if unnamed and others
        else (),
        origin={origin: {}},
    )


def first_s(found: Gathered, topic: str) -> float:
    """Return how long after the beginning of a log its first message came, at most."""
    firsts = [
        (times[0] - start_ns) / SECOND
        for log, (start_ns, _) in enumerate(found.spans_ns)
        if len(times := found.topics[topic].of_log(log))
    ]
    return float(max(firsts, default=0.0))


@contextmanager
def open_log(path: Path) -> Iterator[Recording]:
    """Open a recording of messages; LogRefused if it is none, or cannot be read."""
    with TemporaryDirectory(prefix="robomend-learn-") as folder, plain_log(path, Path(folder)) as plain:
        kind = kind_of(plain.path)
        if kind not in RECORDINGS:
            kinds = ", ".join(RECORDINGS)
            raise LogRefused(
                f"{kind} is no recording of messages ({kinds}): nothing is learned from it", str(path)
            )
        try:
            recording = RECORDINGS[kind](plain.path)
        except Unreadable as error:
            raise LogRefused(str(error), str(path)) from error
        try:
            if plain.problem:
                recording.notes.add(plain.problem, bad=True)
            yield recording
        finally:
            recording.close()


class _Reader:
    """Reads one log."""

    def __init__(self, found: Gathered, recording: Recording, path: Path) -> None:
        self._found = found
        self._recording = recording
        self._path = path
        self._log = len(found.spans_ns)
        self._diagnostics: dict[int, Callable[[bytes], Any]] = {}
        self._discovery: dict[int, Callable[[bytes], Any]] = {}
        self._lines: dict[int, Callable[[bytes], Any]] = {}
        self._fields: dict[int, list[Means]] = {}
        self._publisher = {channel.number: channel.publisher for channel in recording.channels}
        self._topic = {channel.number: channel.topic for channel in recording.channels}

    def read(self) -> None:
        recording, found = self._recording, self._found
        if recording.start_ns is None or recording.end_ns is None:
            found.problems.add(str(self._path), "a recording without messages", bad=True)
            return
        times = {channel.number: array("q") for channel in recording.channels}
        for channel in recording.channels:
            self._open(channel)
        latest_ns = recording.start_ns
        unpacked = (
            self._diagnostics.keys() | self._discovery.keys() | self._lines.keys() | self._fields.keys()
        )
        wanted = {number: number in unpacked for number in times}
        for time_ns, number, data in recording.messages(wanted):
            if number == HOLE:
                continue
            mine = times[number]
            if len(mine) < MOST_TIMES:
                mine.append(time_ns)
            if time_ns > latest_ns:
                latest_ns = time_ns
            if data is not None:
                self._take(number, time_ns, data)
        for some in self._fields.values():
            for means in some:
                means.end(self._log)
        for channel in recording.channels:
            topic = found.topics[channel.topic]
            if len(times[channel.number]) == MOST_TIMES:
                reason = f"nothing is learned from more than {MOST_TIMES:,} messages"
                found.problems.add(f"{self._path}: {channel.topic}", reason, bad=False)
            topic.times[self._log].append(np.array(times[channel.number], dtype=np.int64))
        for reason, bad in recording.notes.take():
            found.problems.add(str(self._path), reason, bad=bad)
        if recording.cut is not None:
            found.problems.add(str(self._path), f"ended early: {recording.cut}", bad=True)
        found.names.append(str(self._path))
        found.spans_ns.append((recording.start_ns, max(latest_ns, recording.start_ns + 1)))

    def _open(self, channel: Channel) -> None:
        """Note a channel, and what of its messages is wanted."""
        topic = self._found.topics.setdefault(channel.topic, Topic(channel.topic))
        topic.types.add(channel.type_name)
        if channel.publisher:
            topic.publishers.add(lasting_name("/" + channel.publisher.strip("/")))
        try:
            store = store_of(channel)
            unpack, name = store.deserialize_cdr if channel.cdr else store.deserialize_ros1, channel.type_name
            if channel.topic == DISCOVERY:
                nodes = "node_entities_info_seq"
                self._discovery[channel.number] = lambda data: plain(getattr(unpack(data, name), nodes))
                return
            if channel.type_name in LOGS:
                self._lines[channel.number] = lambda data: unpack(data, name)
                self._found.errors = self._found.errors or Counter()
                return
            if channel.type_name == STATUSES:
                if self._is_aggregated(channel.topic):
                    return
                self._diagnostics[channel.number] = lambda data: plain(getattr(unpack(data, name), STATUS))
                return
            wanted = []
            for path in number_fields(store.fielddefs, name):
                extract = compile_field(
                    store.fielddefs, name, path, cdr=channel.cdr, whole=lambda data: unpack(data, name)
                )
                wanted.append(Means(topic.fields.setdefault(path, Series()), extract))
        except Exception as error:  # noqa: BLE001  # a type that cannot be parsed: its times are left
            place = f"{self._path}: {channel.topic}"
            self._found.problems.add(place, f"its values cannot be read: {error}", bad=False)
            return
        if wanted:
            self._fields[channel.number] = wanted

    def _is_aggregated(self, topic: str) -> bool:
        """Whether a topic says once more what another one says."""
        plain = topic.removesuffix("_agg")
        return plain != topic and any(
            other.topic == plain and other.type_name == STATUSES for other in self._recording.channels
        )

    def _take(self, number: int, time_ns: int, data: bytes) -> None:
        try:
            if number in self._discovery:
                for node in self._discovery[number](data)[:MOST_NODES]:
                    name = f"{node['node_namespace'].rstrip('/')}/{node['node_name']}"
                    self._found.nodes.add(lasting_name(name))
                return
            if number in self._lines:
                line = self._lines[number](data)
                if reaches(int(line.level), "error"):
                    assert self._found.errors is not None
                    self._found.errors[logged_by(line.name)] += 1
                return
            if number in self._diagnostics:
                for status in self._diagnostics[number](data):
                    self._status(number, time_ns, status)
                return
            for means in self._fields[number]:
                if means.series.count < MOST_VALUES:
                    means.add(self._log, time_ns, float(means.extract(data)))
        except Exception as error:  # noqa: BLE001  # damaged bytes raise whatever
            reason = f"a message cannot be unpacked ({type(error).__name__})"
            self._found.problems.add(str(self._path), reason, bad=True)

    def _status(self, number: int, time_ns: int, status: Mapping[str, Any]) -> None:
        statuses = self._found.statuses
        key = self._topic[number], str(status["name"]).removeprefix("/")
        if key not in statuses and len(statuses) >= MOST_STATUSES:
            return
        mine = statuses.setdefault(key, Status())
        level = status["level"]
        mine.levels.add(self._log, time_ns, float(level[0] if isinstance(level, bytes) else level))
        publisher = self._publisher.get(number)
        if publisher:
            mine.publishers.add(lasting_name("/" + publisher.strip("/")))
        for pair in status["values"]:
            read = number_of(str(pair["value"]))
            if read is not None:
                mine.numbers[str(pair["key"])].add(self._log, time_ns, read)


def number_fields(fields: Mapping[str, Any], type_name: str, depth: int = 0) -> list[str]:
    """Return the paths of a type's floating-point numbers, without those that have no trend to speak of."""
    found: list[str] = []
    for name, (kind, detail) in fields[type_name][1]:
        if any(word in name for word in ASIDE) or depth > 5:
            continue
        if kind == Nodetype.BASE and detail[0] in ("float32", "float64"):
            found.append(name)
        elif kind == Nodetype.NAME:
            found += [f"{name}.{inner}" for inner in number_fields(fields, detail, depth + 1)]
    return found[:MOST_FIELDS]
