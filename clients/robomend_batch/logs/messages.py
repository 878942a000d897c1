"""From recorded messages to changes of literals: the same observers and the same Driver as on the robot.

    channels ──► what an observer wants: the times of a topic, a field, all of it ──► Driver ──► rows

Only topics that an observer needs are read, and of them only the fields that it needs are unpacked. An
observer whose topic is not in the recording is left out: its atoms are unknown. One that is recorded and
silent is silent.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robomend.observations.obs import FOREVER
from robomend_batch.logs.blocks import Advance, Block, Blocks, Opened, Place, Restart
from robomend_batch.logs.chunk import Chunk
from robomend_batch.logs.recorded import (
    HOLE,
    LONG_NS,
    UNTIL,
    InStretches,
    Message,
    Recording,
    Sliced,
    Unreadable,
)
from robomend_batch.logs.wanted import Wants
from robomend_batch.observing import Observing
from robomend_batch.problems import LogRefused, Problems
from robomend_batch.track import Rows
from robomend_batch.words import Setting, Words
from robomend_client.bridges.fields import MissingField
from robomend_client.literals import Atom, Literal
from robomend_client.observers.base import SECOND, Listener
from robomend_client.observers.combining import Change
from robomend_client.observers.driver import Driver
from robomend_client.observers.problems import ObserverProblem
from robomend_client.observers.recording import replay_line

TOGETHER = 1 << 16

OF_LATE_NS = 10 * SECOND
"""So long after its last message a node still publishes a topic."""


def read_messages(open_recording: Callable[[Path], Recording], path: Path, opened: Opened) -> Blocks:
    """Yield the blocks of a recording; LogRefused if nothing of it can be read."""
    observing = opened.observing
    if observing is None:
        raise LogRefused("a recording of messages needs --observers", str(path))
    try:
        recording = open_recording(path)
    except Unreadable as error:
        raise LogRefused(str(error), str(path)) from error
    try:
        yield from _observed(recording, observing, path, opened)
        if recording.cut is not None:
            opened.problems.add(str(path), f"ended early: {recording.cut}", bad=True)
            opened.ended_early = True
        own = recording.checked
        opened.checked = opened.checked if own is None else own
    finally:
        recording.close()


@dataclass
class _Reading:
    """How far a recording was read."""

    driver: Driver
    restarts: Restarts
    changes: Changes
    latest_ns: int
    place: Any = None  # of the recording
    callers: Callers = field(default_factory=lambda: Callers())
    hole: bool = False  # nothing is known of what came up to …
    hole_ns: int = 0  # … and to the next message


def _observed(recording: Recording, observing: Observing, path: Path, opened: Opened) -> Blocks:
    start_ns, end_ns = recording.start_ns, recording.end_ns
    if start_ns is None or end_ns is None:
        _tell(recording, path, opened.problems)
        raise LogRefused("a recording without messages", str(path))
    first_ns = start_ns
    by_header = opened.by_header
    reading: _Reading | None = opened.begun
    with opened.problems.told_before(reading is not None):
        given = recording.channels, observing.specs, path, opened.problems, by_header
        wants = Wants(*given, observing.names)
        _tell(recording, path, opened.problems)
    if not wants.specs:
        raise LogRefused("none of the observers' topics is in it", str(path))
    if reading is None:
        if by_header and (first := next(recording.messages(wants.channels), None)) is not None:
            start_ns = wants.stamp(first)
        restarts = Restarts()
        driver = Driver(
            [spec.make() for spec in wants.specs],
            start_ns,
            lenient=observing.lenient,
            on_problem=Reported(str(path), opened.problems),
            listeners=(restarts,),
        )
        reading = _Reading(driver, restarts, Changes(opened.words("")), start_ns)
        yield Block("", Restart(start_ns))
    driver, restarts, changes = reading.driver, reading.restarts, reading.changes
    of, publishers, looks = wants.of, wants.publishers, wants.looks
    latest_ns, hole = reading.latest_ns, reading.hole
    together = isinstance(recording, InStretches) and not by_header
    stretches: InStretches = recording if together else Sliced(recording)  # type: ignore[assignment]  # it was asked
    for stretch, place in stretches.stretches(wants.channels, reading.place):
        if isinstance(stretch, Chunk) and wants.taken(stretch, driver):
            stretch = ()
        for message in stretch:
            time_ns, number, data = message
            if number < 0 or hole:
                yield from _over_hole(reading, message, by_header)
                hole = reading.hole
                if hole:
                    continue
            if by_header:
                latest_ns = max(latest_ns, time_ns)
                time_ns = wants.stamp(message)
            for source, extract in of[number]:
                value = None
                if extract is not None and data is not None:
                    try:
                        value = extract(data)
                    except MissingField as error:
                        wants.missing(number, error)
                        continue
                    except Exception as error:  # noqa: BLE001  # damaged bytes raise whatever
                        wants.unreadable(number, error)
                        continue
                    if type(value) is float and value - value != 0.0:
                        opened.problems.add(f"{path}: {source}", "no number (NaN, or infinite)", bad=False)
                changed = driver.sample(source, time_ns, value)
                if changed or restarts.at_ns is not None:
                    yield from changes.take(changed, restarts.take())
            if number in publishers and driver.now_ns == time_ns:  # else the stamp is far off
                source, node = publishers[number]
                if (nodes := reading.callers.heard(source, node, time_ns)) is not None:
                    yield from changes.take(driver.publishers(source, nodes, time_ns), restarts.take())
            elif number in looks and data is not None:
                try:
                    changed = _looked(driver, data, time_ns)
                except (ValueError, KeyError, TypeError) as error:
                    wants.unreadable(number, error)
                else:
                    yield from changes.take(changed, restarts.take())
        reading.latest_ns = latest_ns = max(latest_ns, driver.now_ns) if not by_header else latest_ns
        reading.place = place
        _tell(recording, path, opened.problems)
        if place is not None:
            yield Block("", Place(reading, (latest_ns - first_ns) / max(1, end_ns - first_ns)))
    _tell(recording, path, opened.problems)  # of what was found where no message came any more, too
    end_ns = latest_ns if recording.cut else max(end_ns, latest_ns)
    if restarts.seen or by_header:  # the end of the recording is by another clock
        end_ns = driver.now_ns
    if reading.hole:  # it ends in what could not be read
        end_ns = max(driver.now_ns, reading.hole_ns)
    else:
        changed = driver.advance(end_ns)
        yield from changes.take(changed, restarts.take())
    yield from changes.rest()
    yield Block("", Advance(end_ns))


def _looked(driver: Driver, data: bytes, time_ns: int) -> list[Change]:
    """Take in a line of what the agent that recorded it did not look at."""
    line = json.loads(data)
    if time_ns - driver.now_ns >= LONG_NS or {"source", "restart", "end"} & line.keys():
        raise ValueError("no such line is written, or not at such a time")
    return list(replay_line(driver, {**line, "at": time_ns}))


class Callers:
    """Which nodes publish a topic, by whose messages came of late."""

    def __init__(self) -> None:
        self._heard: dict[str, dict[str, int]] = {}
        self._told: dict[str, list[str]] = {}

    def heard(self, source: str, node: str, time_ns: int) -> list[str] | None:
        """Take in that a message came; return all who publish it where they are others than before."""
        from robomend_client.ros_graph import lasting_name  # few observers ask for publishers

        heard = self._heard.setdefault(source, {})
        heard[lasting_name(node)] = time_ns
        nodes = sorted(name for name, at_ns in heard.items() if abs(time_ns - at_ns) < OF_LATE_NS)
        if self._told.get(source) == nodes:
            return None
        self._told[source] = nodes
        return nodes


def _over_hole(reading: _Reading, message: Message, by_header: bool) -> Blocks:
    """Begin what could not be read, or end it: what is said of it is that nothing is known."""
    time_ns, number, data = message
    driver, restarts = reading.driver, reading.restarts
    seen = restarts.seen
    if number == HOLE:
        (until_ns,) = UNTIL.unpack(data or UNTIL.pack(time_ns))
        if reading.hole:
            reading.hole_ns = max(reading.hole_ns, until_ns)
            return
        reading.hole, reading.hole_ns = True, until_ns
        if not by_header:  # by another clock it begins with the last message before it
            yield from reading.changes.take(driver.advance(time_ns), restarts.take())
        driver.restart(driver.now_ns)
        yield from reading.changes.take([], restarts.take())
    elif time_ns >= reading.hole_ns:
        reading.hole = False
        driver.restart(driver.now_ns if by_header else time_ns)
        restarts.take()
    restarts.seen = seen


def _tell(recording: Recording, path: Path, problems: Problems) -> None:
    for reason, bad in recording.notes.take():
        problems.add(str(path), reason, bad=bad)


@dataclass(frozen=True, slots=True)
class Reported:
    """Notes what a driver finds wrong."""

    path: str
    problems: Problems

    def __call__(self, problem: ObserverProblem) -> None:
        if problem.what != "number":  # each of those is counted where it is read
            lost = problem.what == "kind"  # like a field that a type does not have
            self.problems.add(f"{self.path}: {problem.where}", problem.message, bad=lost)


class Restarts(Listener):
    """Notes where time begins again."""

    def __init__(self) -> None:
        self.at_ns: int | None = None
        self.seen = False

    def restart(self, now_ns: int) -> None:
        self.at_ns = now_ns
        self.seen = True

    def take(self) -> int | None:
        at_ns, self.at_ns = self.at_ns, None
        return at_ns


class Changes:
    """Changes of literals, gathered into rows."""

    def __init__(self, words: Words) -> None:
        self._words = words
        self._settings: dict[tuple[Atom, bool | None], tuple[Setting, ...]] = {}
        self._clear()

    def _clear(self) -> None:
        self._time, self._sensor, self._value = array("q"), array("i"), array("b")

    def take(self, changes: Iterable[Change], restart_ns: int | None) -> Blocks:
        """Take in changes; `restart_ns`: time began again among them, and what was before is unknown."""
        if restart_ns is not None:
            yield from self.rest()
            yield Block("", Restart(restart_ns))
            changes = [change for change in changes if change.value is not None]
        self._add(changes)
        if len(self._time) >= TOGETHER:
            yield from self.rest()

    def rest(self) -> Blocks:
        """Yield what was gathered."""
        if self._time:
            yield Block(
                "",
                Rows(
                    np.array(self._time, dtype=np.int64),
                    np.array(self._sensor, dtype=np.int32),
                    np.array(self._value, dtype=np.int8),
                    np.full(len(self._time), FOREVER, dtype=np.int64),
                ),
            )
            self._clear()

    def _add(self, changes: Iterable[Change]) -> None:
        # What is not known any more comes first: a trend that follows another denies it.
        for change in sorted(changes, key=lambda change: (change.time_ns, change.value is not None)):
            shown = None if change.value is None else change.value.positive
            key = change.atom, shown
            settings = self._settings.get(key)
            if settings is None:
                settings = self._settings[key] = self._of(change.atom, shown)
            if change.reading is not None and change.reading.symptom is not None:
                self._words.measured(change)
            for sensor, value in settings:
                self._time.append(change.time_ns)
                self._sensor.append(sensor)
                self._value.append(value)

    def _of(self, atom: Atom, shown: bool | None) -> tuple[Setting, ...]:
        canonical = self._words.canonical(Literal(atom, shown is not False))
        return self._words.unknown(canonical.atom) if shown is None else self._words.of(canonical)
