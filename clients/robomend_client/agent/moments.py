"""Moments: what was there when a literal turned bad, kept at once and handed in after the observations.

    samples, messages, processes ──► kept, a little of each
    a literal turns bad ──► a moment is open ──GATHER_S──► first frame ──after_s──► whole frame, recording
                                                              │                          │
                                         STATE_DIR/moments ◄──┴──────────────────────────┘ ──► the service

Others that turn bad meanwhile are of the same moment. A moment is on the disk before it is sent, and goes
from there once the service has all of it; it is sent when no observation waits. A frame that the disk does
not take is sent from memory. What is refused is logged and lost by itself.

docs/agent.md, "Moments", has what is in a frame, and the bounds.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from robomend_client.agent.config import MomentsConfig
from robomend_client.agent.feeds import split
from robomend_client.agent.processes import SupervisedProcess
from robomend_client.agent.ring import LARGE, Kept, Ring, RingTopic, write
from robomend_client.clock import Clock
from robomend_client.literals import Atom
from robomend_client.observers import PROCESSES, SECOND, Change, Contact, Publishers
from robomend_client.outbox import LATER
from robomend_client.python310 import timeout
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.errors import ClientError, NotFound

log = logging.getLogger(__name__)

NODES = "nodes"
TABLES = (NODES, PROCESSES)
"""Sources whose samples are tables of what runs."""

TRENDS = frozenset({"inc", "dec", "const"})
"""Predicates of which `not` is nothing bad."""

GATHER_S = 1.0
"""What turns bad within so long is in the first frame, and a process has said its last words."""

BURST = 3
"""Moments that may follow each other at once; further ones come at their rate."""

MOST_WAITING = 100
"""Moments on the disk."""

MOST_IN_MEMORY = 3
"""Moments that the disk did not take, until the service has them."""

MOST_LITERALS = 100
PIECE = 256 * 1024
"""Bytes of a recording that are sent together."""

AGAIN_S = (1.0, 60.0)
"""After a try in vain: twice as long each time, up to that."""

BIN_NS = SECOND // 4
"""Of the samples of a source within so long one is kept, and how many they were."""

MOST_SOURCES = 2000

CONCERNED, OTHER = (2000, 40), (500, 5)
"""Characters of a message, and lines of a log, of what is bad and of what is not."""

FRAME = {"topics": 96 * 1024, "logs": 48 * 1024, "series": 64 * 1024}
"""Characters of each part of a frame."""

MOST_NOTES = 20
"""In a frame, of what is not in it and of when nobody looked; the service takes 50 in all."""

LINE = 500
FURTHEST_S = 1e9
TAIL = 16 * 1024


class Watched(NamedTuple):
    """What an observer of the agent's file speaks of, and what it is fed with."""

    atoms: tuple[Atom, ...]
    sources: frozenset[str]


class _Bin:
    """The samples of a quarter of a second."""

    __slots__ = ("count", "number", "value")

    def __init__(self, number: int, value: float | None) -> None:
        self.number = number
        self.count = 1
        self.value = value


@dataclass
class _OpenMoment:
    """A moment that is open."""

    key: str
    at_ns: int
    literals: list[dict[str, Any]] = field(default_factory=list)
    concerned: set[str] = field(default_factory=set)  # sources of what turned bad
    names: set[str] = field(default_factory=set)  # in the atoms: of topics, of nodes
    last: dict[str, list[Kept]] = field(default_factory=dict)  # topic -> its last messages then
    said: dict[str, tuple[int, object]] = field(default_factory=dict)  # likewise, on the bus


class Moments:
    """See the module."""

    def __init__(
        self,
        config: MomentsConfig,
        robot: str,
        agent: str,
        folder: Path,
        clock: Clock,
        watched: Iterable[Watched],
    ) -> None:
        self.config = config
        self.ring = Ring(config.before_s, int(config.memory_mb * 1024 * 1024), record=config.record)
        self._robot = robot
        self._agent = agent
        self._folder = folder
        self._clock = clock
        self.processes: Mapping[str, SupervisedProcess] = {}
        self._watched: dict[Atom, set[str]] = {}
        for one in watched:
            for atom in one.atoms:
                self._watched.setdefault(atom, set()).update(one.sources)
        most = int((config.before_s + config.after_s) * SECOND / BIN_NS) + 8
        self._series: dict[str, deque[_Bin]] = {}
        self._most_bins = most
        self._said: dict[str, tuple[int, object]] = {}  # topic of the bus -> its last message
        self._publishers: dict[str, tuple[str, ...]] = {}  # source -> nodes
        self._nodes: dict[str, bool | None] = {}
        self._bad: set[Atom] = set()
        self._open: _OpenMoment | None = None
        self._unwritten: dict[str, bytes] = {}  # name -> a frame that is newer than what the disk has of it
        self._ending: str | None = None  # the name of one whose whole frame is being written
        self._opened = asyncio.Event()
        self._waits = asyncio.Event()  # there may be something to be sent
        self._budget, self._budget_s = float(BURST), time.monotonic()
        self._missed = 0

    # --- what happens ----------------------------------------------------------------------------------

    def sample(self, source: str, time_ns: int, value: object) -> None:
        """An observer is fed with this."""
        if isinstance(value, (Publishers, Contact)) or source in TABLES:
            self._graph(source, value)
            return
        bins = self._series.get(source)
        if bins is None:
            if len(self._series) >= MOST_SOURCES:
                return
            bins = self._series[source] = deque(maxlen=self._most_bins)
        number = time_ns // BIN_NS
        if bins:
            newest = bins[-1]
            if newest.number == number:
                newest.count += 1
                if isinstance(value, (int, float)):
                    newest.value = value
                return
            if number < newest.number - SECOND // BIN_NS:
                bins.clear()  # the clock went back
        bins.append(_Bin(number, value if isinstance(value, (int, float)) else None))

    def _graph(self, source: str, value: object) -> None:
        if isinstance(value, Publishers):
            self._publishers[source] = value.nodes
        elif source == NODES and isinstance(value, Mapping):
            self._nodes = {str(name): None if runs is None else runs is True for name, runs in value.items()}

    def said(self, topic: str, time_ns: int | None, data: object) -> None:
        """Something was said on the bus; without a time, just now."""
        time_ns = self._clock.now_ns() if time_ns is None else time_ns
        if topic in self._said or len(self._said) < MOST_SOURCES:
            self._said[topic] = (time_ns, data)

    def changed(self, changes: Iterable[Change]) -> None:
        """The observers have found this."""
        for change in changes:
            if change.value is None or change.atom.predicate in TRENDS:
                continue
            if change.value.positive:
                self._bad.discard(change.atom)
            elif change.atom not in self._bad:
                self._bad.add(change.atom)
                self._turned_bad(change)

    def _turned_bad(self, change: Change) -> None:
        one = self._open
        if one is None:
            process = self.processes.get(change.atom.args[0]) if change.atom.predicate == "running" else None
            if process is not None and process.resting:
                return
            if not self._may_open():
                self._missed += 1
                log.info("%s: no moment is kept of it, there were too many", change.value)
                return
            one = self._open = _OpenMoment(uuid.uuid4().hex, change.time_ns)
            one.last = {name: list(topic.last) for name, topic in self.ring.topics.items()}
            one.said = dict(self._said)
            self.ring.hold(change.time_ns)
            self._opened.set()
        if len(one.literals) < MOST_LITERALS:
            literal: dict[str, Any] = {
                "literal": str(change.value),
                "at_s": seconds(change.time_ns, one.at_ns),
            }
            if change.reading is not None:
                literal["reading"] = clean(str(change.reading), 500)
            one.literals.append(literal)
            one.concerned |= self._watched.get(change.atom, set())
            one.names.update(change.atom.args)

    def _may_open(self) -> bool:
        now_s = time.monotonic()
        self._budget = min(BURST, self._budget + (now_s - self._budget_s) * self.config.per_hour / 3600)
        self._budget_s = now_s
        if self._budget < 1:
            return False
        self._budget -= 1
        return True

    # --- from an open moment to the disk -----------------------------------------------------------------

    async def run(self) -> None:
        """Write down what is open, for ever; what is open when that ends is written by `close`."""
        while True:
            await self._opened.wait()
            self._opened.clear()
            one = self._open
            if one is None:
                continue
            await asyncio.sleep(min(GATHER_S, self.config.after_s))
            if self.config.after_s > GATHER_S:
                await self._write(one, complete=False)
                await asyncio.sleep(self.config.after_s - GATHER_S)
            await self._end(one)

    async def close(self) -> None:
        """Write down what is open."""
        if self._open is not None:
            await self._end(self._open)

    async def _end(self, one: _OpenMoment) -> None:
        notes = await self._record(one) if self.config.record else []
        self._open, self._ending = None, _name(one)
        self.ring.let_go()
        try:
            await self._write(one, complete=True, notes=notes)
        finally:
            self._ending = None
        self._waits.set()

    async def _record(self, one: _OpenMoment) -> list[str]:
        """Write the recording; return what is to be said of it."""
        since_ns, until_ns = one.at_ns - int(self.config.before_s * SECOND), self._clock.now_ns()
        topics = self.ring.recorded(since_ns, until_ns)
        file = self._folder / f"{_name(one)}.mcap"
        new = file.with_suffix(f".{time.monotonic_ns()}.new")  # a thread may be left of one that was cut off
        said = {"robot": self._robot, "agent": self._agent, "at_ns": one.at_ns, "literals": one.literals}
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            looks, about = self.ring.looks(since_ns, until_ns), json.dumps(said).encode()
            made = await asyncio.to_thread(write, new, topics, looks, since_ns, until_ns, about)
            _make_room(self._folder, self._most_bytes, new.stat().st_size, keep=_name(one))
            new.replace(file)
        except Exception as error:  # noqa: BLE001  # a full disk, or a definition from anybody
            log.error("the recording of a moment is lost: %s", error)
            with contextlib.suppress(OSError):
                new.unlink(missing_ok=True)
            return [clean(f"not recorded: {error}", LINE)]
        return [clean(note, LINE) for note in made[:MOST_NOTES]]

    async def _write(self, one: _OpenMoment, *, complete: bool, notes: Sequence[str] = ()) -> None:
        try:
            # As it is now: more may turn bad while the thread is at work.
            now = replace(one, literals=[*one.literals], concerned={*one.concerned}, names={*one.names})
            text = await asyncio.to_thread(self._made, now, self._facts(one), complete, notes)
        except Exception as error:  # noqa: BLE001  # what robots say may be anything
            log.error("a moment is lost, %s: %s", one.literals[0]["literal"], error)
            with contextlib.suppress(OSError):
                (self._folder / f"{_name(one)}.mcap").unlink(missing_ok=True)
            return
        try:
            await asyncio.to_thread(self._put, _name(one), text)
            self._unwritten.pop(_name(one), None)
        except OSError as error:
            log.error("a moment is kept in memory until it is sent, as the disk does not take it: %s", error)
            self._unwritten[_name(one)] = text
            while len(self._unwritten) > MOST_IN_MEMORY:
                log.error("a moment is lost: more wait than are kept in memory")
                del self._unwritten[min(self._unwritten)]
        self._waits.set()

    def _facts(self, one: _OpenMoment) -> _Facts:
        """Return what the frame is made of, as it is now: a thread makes the text of it."""
        series = {
            source: [(each.number, each.count, each.value) for each in bins]
            for source, bins in self._series.items()
        }
        logs = {name: process.output_tail(TAIL) for name, process in self.processes.items()}
        table = [
            {
                "node": name,
                "pid": None if process.handle is None else process.handle.pid,
                "about": clean(process.described(), 500),
            }
            for name, process in self.processes.items()
        ]
        topics = {name: self.ring.topics[name] for name in one.last if name in self.ring.topics}
        graph, now_ns = (dict(self._publishers), dict(self._nodes)), self._clock.now_ns()
        looks = self.ring.looks(one.at_ns - int(self.config.before_s * SECOND), now_ns)
        return _Facts(now_ns, looks, series, logs, table, topics, *graph)

    def _made(self, one: _OpenMoment, facts: _Facts, complete: bool, notes: Sequence[str]) -> bytes:
        """Return the frame, as it is sent."""
        frame = make_frame(one, facts, notes)
        frame["notes"] += [said for line in facts.looks if (said := _looked(line, one.at_ns))][-MOST_NOTES:]
        if self._missed:
            frame["notes"].append(f"no moment was kept of {self._missed} literals before this one")
            self._missed = 0 if complete else self._missed
        moment = {
            "agent": self._agent,
            "key": one.key,
            "at_ns": one.at_ns,
            "literals": list(one.literals),
            "complete": complete,
            "frame": frame,
        }
        return json.dumps(moment, separators=(",", ":"), allow_nan=False).encode()

    def _put(self, name: str, text: bytes) -> None:
        """Write it down. OSError: the disk is full, or may have no more."""
        self._folder.mkdir(parents=True, exist_ok=True)
        _make_room(self._folder, self._most_bytes, len(text), keep=name)
        new = self._folder / f"{name}.{time.monotonic_ns()}.new"
        try:
            new.write_bytes(text)
            new.replace(self._folder / f"{name}.json")
        except OSError:
            with contextlib.suppress(OSError):
                new.unlink(missing_ok=True)
            raise

    @property
    def _most_bytes(self) -> int:
        return int(self.config.disk_mb * 1024 * 1024)

    # --- to the service ------------------------------------------------------------------------------------

    async def send(self, client: AsyncClient, quiet: Callable[[], bool]) -> None:
        """Hand in what waits on the disk, the oldest first, for ever.

        Args:
            quiet: whether no observation waits to be sent.
        """
        sent: set[str] = set()  # first frames, of which there will be more
        wait_s = AGAIN_S[0]
        failures = 0
        for left in self._folder.glob("*.new"):  # of an agent that was killed while it wrote
            left.unlink(missing_ok=True)
        while True:
            with contextlib.suppress(TimeoutError):
                async with timeout(wait_s):
                    await self._waits.wait()
            self._waits.clear()
            try:
                arrived = await self._send_all(client, quiet, sent)
            except OSError as error:
                log.error("moments cannot be read: %s", error)
                arrived = False
            failures = 0 if arrived else failures + 1
            wait_s = min(AGAIN_S[0] * 2 ** min(failures, 10), AGAIN_S[1]) if failures else AGAIN_S[1]

    async def _send_all(self, client: AsyncClient, quiet: Callable[[], bool], sent: set[str]) -> bool:
        """Return whether nothing is left that could be sent."""
        names = {file.stem for file in self._folder.glob("*.json")}
        for file in (self._folder / f"{name}.json" for name in sorted(names.union(self._unwritten))):
            is_open = file.stem == self._ending or (self._open is not None and file.stem == _name(self._open))
            if is_open and file.stem in sent:
                continue
            if not quiet():
                return False
            try:
                if not await self._send_one(client, file, quiet, is_open=is_open):
                    return False
            except LATER as error:
                log.debug("a moment waits: %s", error)
                return False
            except (ClientError, KeyError, TypeError, ValueError) as error:
                log.error("the service refused a moment: %s", error)
                is_open = False
            if is_open:
                sent.add(file.stem)
            else:
                sent.discard(file.stem)
                self._unwritten.pop(file.stem, None)
                file.unlink(missing_ok=True)
                file.with_suffix(".mcap").unlink(missing_ok=True)
        return True

    async def _send_one(
        self, client: AsyncClient, file: Path, quiet: Callable[[], bool], *, is_open: bool
    ) -> bool:
        """Send a moment; return False where observations have come in between: they go first."""
        text = self._unwritten.get(file.stem)
        moment = json.loads(await asyncio.to_thread(file.read_bytes) if text is None else text)
        if not is_open:
            moment["complete"] = True  # also of an agent that was killed before it was
        kept = await client.keep_moment(self._robot, moment)
        recording = file.with_suffix(".mcap")
        if is_open or not recording.exists():
            return True
        size, have = recording.stat().st_size, int(kept["have"])
        while have < size:
            if not quiet():
                return False
            piece = await asyncio.to_thread(_piece, recording, have)
            try:
                now = await client.keep_recording(
                    self._robot, str(kept["id"]), at=have, size=size, data=piece
                )
            except NotFound as error:
                log.error("the service keeps a moment no more: %s", error)
                return True
            if now == have:  # it is of another mind, for good
                log.error("the service takes no more than %d bytes of a recording", have)
                return True
            have = now
        return True


class _Facts(NamedTuple):
    """What a frame is made of."""

    now_ns: int
    looks: list[dict[str, Any]]
    series: dict[str, list[tuple[int, int, float | None]]]
    logs: dict[str, str]
    processes: list[dict[str, Any]]
    topics: dict[str, RingTopic]
    publishers: dict[str, tuple[str, ...]]
    nodes: dict[str, bool | None]


def make_frame(one: _OpenMoment, facts: _Facts, notes: Sequence[str]) -> dict[str, Any]:
    """Return the freeze frame of a moment: first what is bad, then the rest, as far as there is room."""
    found = list(notes)
    concerned = {split(source)[0] for source in one.concerned} | one.names

    def is_bad(topic: str) -> bool:
        name = topic.removeprefix("/")
        return name in concerned or any(name.endswith(f"/{each}") for each in concerned)

    publishers = {split(source)[0]: nodes for source, nodes in facts.publishers.items()}
    bad_nodes = {
        name
        for topic, nodes in publishers.items()
        if is_bad(topic)
        for name in (each.removeprefix("/") for each in nodes)
    } | one.names
    names = sorted({*one.last, *one.said}, key=lambda name: (not is_bad(name), name))
    topics = _within("topics", (_topic(name, one, facts, publishers, is_bad(name)) for name in names), found)
    series = _within(
        "series",
        (
            drawn
            for source in sorted(facts.series, key=lambda s: (s not in one.concerned, s))
            if (
                drawn := _series(
                    source, facts.series[source], one.at_ns, facts.now_ns, source in one.concerned
                )
            )
        ),
        found,
    )
    logs = _within(
        "logs",
        (
            {"node": node, "lines": lines}
            for node in sorted(facts.logs, key=lambda name: (name not in bad_nodes, name))
            if (lines := last_lines(facts.logs[node], (CONCERNED if node in bad_nodes else OTHER)[1]))
        ),
        found,
    )
    processes = sorted(facts.processes, key=lambda row: (row["node"] not in bad_nodes, row["node"]))
    return {
        "topics": topics[:500],
        "series": series[:200],
        "logs": logs[:200],
        "processes": processes[:500],
        "nodes": {clean(name, 300): runs for name, runs in list(facts.nodes.items())[:2000]},
        "notes": found[:MOST_NOTES],
    }


def _within(part: str, made: Iterable[dict[str, Any]], notes: list[str]) -> list[dict[str, Any]]:
    """Return the first ones that fit the part of a frame; what does not fit is noted."""
    found, left, out = [], FRAME[part], 0
    for one in made:
        left -= len(json.dumps(one))
        if left < 0:
            out += 1
            left = 0
        else:
            found.append(one)
    if out:
        notes.append(f"of the {part}, {out} did not fit")
    return found


def _topic(
    name: str, one: _OpenMoment, facts: _Facts, publishers: Mapping[str, Sequence[str]], bad: bool
) -> dict[str, Any]:
    most = (CONCERNED if bad else OTHER)[0]
    by = publishers.get(name.removeprefix("/"), publishers.get(name, ()))
    told: dict[str, Any] = {
        "topic": clean(name, 300),
        "by": [clean(node, 300) for node in by[:50]],
        "messages": [],
    }
    if name in one.said:
        time_ns, data = one.said[name]
        text = clean(json.dumps(data, ensure_ascii=False, default=str)[: 4 * most], most)
        told["messages"] = [{"at_s": seconds(time_ns, one.at_ns), "text": text}]
        return told
    for kept in one.last[name][-(3 if bad else 1) :]:
        try:
            described = facts.topics[name].describe(kept.about)
            told["type"] = clean(described.type, 300)
            if kept.data is None:
                text = f"not kept: it is larger than {LARGE // 1024} kB, or empty"
            else:
                text = described.text(kept.data, most)
        except Exception as error:  # noqa: BLE001  # bytes and definition come from anybody
            text = f"it cannot be read: {error}"
        told["messages"].append({"at_s": seconds(kept.time_ns, one.at_ns), "text": clean(text, most)})
    return told


def _series(
    source: str, bins: Sequence[tuple[int, int, float | None]], at_ns: int, until_ns: int, concerned: bool
) -> dict[str, Any] | None:
    """Return what an observer was fed with; of sources that are not concerned, numbers only."""
    numbers = [(number, value) for number, _, value in bins if value is not None and abs(value) < 1e300]
    if not numbers and not concerned:
        return None
    if numbers:
        step = 1 if concerned else 4
        points = [(seconds(number * BIN_NS, at_ns), float(value)) for number, value in numbers[::step]]
        kind = "value"
    else:
        kind, points = "rate", _rates(bins, at_ns, until_ns)[-2000:]
    return {
        "source": clean(source, 300),
        "kind": kind,
        "at_s": [round(at_s, 3) for at_s, _ in points],
        "values": [value for _, value in points],
    }


def _rates(
    bins: Sequence[tuple[int, int, float | None]], at_ns: int, until_ns: int
) -> list[tuple[float, float]]:
    """Return how many came in each second, from the first one on, as far as it is known."""
    a_second = SECOND // BIN_NS
    if not bins:
        return []
    counts: dict[int, int] = {}
    at = at_ns // BIN_NS
    for number, count, _ in bins:
        second = (number - at) // a_second
        counts[second] = counts.get(second, 0) + count
    first, last = min(counts) + 1, (until_ns - at_ns) // SECOND  # the first one is not whole
    return [(float(second), float(counts.get(second, 0))) for second in range(first, last)]


def last_lines(output: str, most: int) -> list[str]:
    """Return the last lines of a process's output, each within its bound."""
    lines = [clean(line, LINE) for line in output[-TAIL:].splitlines()[-most:]]
    return [line for line in lines if line.strip()]


def clean(text: str, most: int) -> str:
    """Return a text without what a terminal or a page would obey, cut to so many characters."""
    cut = len(text) > most
    text = text[:most]
    if not text.isprintable():
        text = "".join(one if one.isprintable() or one in "\n\t" else f"\\x{ord(one):02x}" for one in text)
    return text if len(text) <= most and not cut else text[: most - 1] + "…"


def _looked(line: dict[str, Any], at_ns: int) -> str:
    """Return what people are to know of a line of the ring; nothing: nothing."""
    if "lapse" in line:
        lapse_s = (line["lapse"] - line["at"]) / SECOND
        return f"nobody looked for {lapse_s:.1f} s until {seconds(line['lapse'], at_ns):.1f} s"
    if "starved" in line:
        began = "from" if line["starved"] else "until"
        said = f"this computer was overloaded {began} {seconds(line['at'], at_ns):.1f} s"
        return f"{said}: what came late then was not called bad"
    return ""


def seconds(time_ns: int, at_ns: int) -> float:
    """Return how long after the moment something was; clocks may have jumped by any time in between."""
    return max(-FURTHEST_S, min(FURTHEST_S, (time_ns - at_ns) / SECOND))


def _name(one: _OpenMoment) -> str:
    return f"{one.at_ns:020d}-{one.key}"


def _piece(file: Path, at: int) -> bytes:
    with file.open("rb") as recording:
        recording.seek(at)
        return recording.read(PIECE)


def _make_room(folder: Path, most: int, wanted: int, keep: str) -> None:
    """Forget the oldest moments that wait, where the disk that they may have would be too small.

    Raises:
        OSError: what is wanted does not fit at all.
    """
    if wanted > most:
        raise OSError(f"it has {wanted} bytes, and disk_mb is {most / 1024 / 1024:g}")
    files = sorted(file for file in folder.iterdir() if file.suffix in (".json", ".mcap"))
    sizes = {file: file.stat().st_size for file in files}
    moments = sorted({file.stem for file in files} - {keep})
    total = sum(sizes.values()) + wanted
    while moments and (total > most or len(moments) >= MOST_WAITING):
        oldest = moments.pop(0)
        log.warning("a moment is forgotten, of those that wait: there is no room for all")
        for file in files:
            if file.stem == oldest:
                total -= sizes[file]
                os.unlink(file)
