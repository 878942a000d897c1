"""From recorded messages to changes of literals: the same observers and the same Driver as on the robot.

    channels ──► what an observer wants: the times of a topic, a field, all of it ──► Driver ──► rows

Only topics that an observer needs are read, and of them only the fields that it needs are unpacked. An
observer whose topic is not in the recording is left out: its atoms are unknown. One that is recorded and
silent is silent.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robomend.observations.obs import FOREVER
from robomend_batch.logs.blocks import Advance, Block, Blocks, Opened, Place, Restart
from robomend_batch.logs.recorded import (
    Channel,
    InStretches,
    Message,
    Recording,
    Sliced,
    Together,
    Unreadable,
)
from robomend_batch.observing import Observing
from robomend_batch.problems import LogRefused, Problems
from robomend_batch.track import Rows
from robomend_batch.words import Setting, Words
from robomend_client.bridges.fields import MissingField
from robomend_client.bridges.measured import is_board, measured
from robomend_client.literals import Atom, Literal
from robomend_client.observers.base import SECOND
from robomend_client.observers.combining import Change
from robomend_client.observers.driver import Driver
from robomend_client.observers.kinds import ObserverSpec
from robomend_client.observers.listener import Listener
from robomend_client.observers.problems import ObserverProblem

if TYPE_CHECKING:
    from robomend_batch.logs.columns import Column

WHOLE = {"diagnostics": ("diagnostics", "status"), "board": ("board_measurments", "channel")}
"""Sources that are more than times or a number: their topic, and the field that observers get, as the bridges
have it.
"""

TOGETHER = 1 << 16

Want = tuple[str, Callable[[bytes], Any] | None]
"""A source, and what makes its value of a message; None: its times suffice."""


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


def _observed(recording: Recording, observing: Observing, path: Path, opened: Opened) -> Blocks:
    start_ns, end_ns = recording.start_ns, recording.end_ns
    if start_ns is None or end_ns is None:
        raise LogRefused("a recording without messages", str(path))
    by_header = opened.by_header
    reading: _Reading | None = opened.begun
    with opened.problems.told_before(reading is not None):
        wants = Wants(recording.channels, observing.specs, path, opened.problems, by_header)
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
            listener=restarts,
        )
        reading = _Reading(driver, restarts, Changes(opened.words("")), start_ns)
        yield Block("", Restart(start_ns))
    driver, restarts, changes = reading.driver, reading.restarts, reading.changes
    latest_ns = reading.latest_ns
    together = isinstance(recording, InStretches) and not by_header
    given: InStretches = recording if together else Sliced(recording)  # type: ignore[assignment]  # it was asked
    for stretch, place in given.stretches(wants.channels, reading.place):
        if isinstance(stretch, Together) and wants.taken(stretch, driver):
            opened.rows += stretch.count
            stretch = ()
        for message in stretch:
            time_ns, number, data = message
            opened.rows += 1
            if time_ns > latest_ns:
                latest_ns = time_ns
            if by_header:
                time_ns = wants.stamp(message)
            for source, extract in wants.of[number]:
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
        reading.latest_ns, reading.place = latest_ns, place
        if place is not None:
            yield Block("", Place(reading))
    latest_ns = max(latest_ns, driver.now_ns) if not by_header else latest_ns
    end_ns = latest_ns if recording.cut else max(end_ns, latest_ns)
    if restarts.seen or by_header:  # the end of the recording is by another clock
        end_ns = driver.now_ns
    changed = driver.advance(end_ns)
    yield from changes.take(changed, restarts.take())
    yield from changes.rest()
    yield Block("", Advance(end_ns))


@dataclass(frozen=True, slots=True)
class Reported:
    """Notes what a driver finds wrong."""

    path: str
    problems: Problems

    def __call__(self, problem: ObserverProblem) -> None:
        if problem.what != "number":  # each of those is counted where it is read
            self.problems.add(f"{self.path}: {problem.where}", problem.message, bad=False)


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
            for sensor, value in settings:
                self._time.append(change.time_ns)
                self._sensor.append(sensor)
                self._value.append(value)

    def _of(self, atom: Atom, shown: bool | None) -> tuple[Setting, ...]:
        canonical = self._words.canonical(Literal(atom, shown is not False))
        return self._words.unknown(canonical.atom) if shown is None else self._words.of(canonical)


class Wants:
    """What of a recording is wanted, and by which observers."""

    def __init__(
        self,
        channels: Iterable[Channel],
        specs: Iterable[ObserverSpec],
        path: Path,
        problems: Problems,
        by_header: bool,
    ) -> None:
        self.of: dict[int, list[Want]] = {}
        """Channel -> sources."""
        self.channels: dict[int, bool] = {}
        """Channel -> whether its messages' bytes are needed."""
        self.stamps: dict[int, Callable[[bytes], int]] = {}
        self._path = path
        self._problems = problems
        self._by_topic: dict[str, list[Channel]] = {}
        self._topic_of: dict[int, str] = {}
        for channel in channels:
            self._by_topic.setdefault(channel.topic, []).append(channel)
            self._topic_of[channel.number] = channel.topic
        self._types: dict[str, Any] = {}
        self._columns: dict[tuple[int, str], Column] = {}
        found: dict[str, list[tuple[int, Want]] | None] = {}
        self.specs = []
        for spec in specs:
            for source in sorted(spec.sources):
                if source not in found:
                    found[source] = self._source(source)
            if all(found[source] is not None for source in spec.sources):
                self.specs.append(spec)
        for source in sorted({source for spec in self.specs for source in spec.sources}):
            for number, want in found[source] or ():
                self.of.setdefault(number, []).append(want)
                self.channels[number] = self.channels.get(number, False) or want[1] is not None
        if by_header:
            self._by_header()

    def stamp(self, message: Message) -> int:
        """Return the time in a message's header; when it was recorded, if it has none."""
        time_ns, number, data = message
        stamp = self.stamps.get(number)
        if stamp is None or data is None:
            return time_ns
        try:
            return stamp(data)
        except Exception as error:  # noqa: BLE001  # damaged bytes raise whatever
            self.unreadable(number, error)
            return time_ns

    def taken(self, stretch: Together, driver: Driver) -> bool:
        """Return whether a driver takes in a stretch at once; else nothing of it was taken in."""
        samples: dict[str, tuple[Any, Callable[[], Any] | None]] = {}
        for number, times_ns in stretch.times_ns.items():
            for source, extract in self.of[number]:
                column = self._columns.get((number, source))
                if source in samples or (extract is not None and column is None):
                    return False
                samples[source] = times_ns, column and partial(_values, column, stretch, number)
        if not samples or any((times_ns[1:] < times_ns[:-1]).any() for times_ns, _ in samples.values()):
            return False
        together = np.sort(np.concatenate([*stretch.times_ns.values()]))
        first_ns, gap_ns = int(together[0]), int(np.diff(together).max(initial=0))
        if first_ns < driver.now_ns:
            return False
        return driver.quiet(samples, max(gap_ns, first_ns - driver.now_ns), int(together[-1]))

    def unreadable(self, number: int, error: Exception) -> None:
        """A message could not be unpacked: it is left out, and counted."""
        place = f"{self._path}: {self._topic_of[number]}"
        self._problems.add(place, f"a message cannot be unpacked ({type(error).__name__})", bad=True)

    def missing(self, number: int, error: Exception) -> None:
        """What is looked for is not in a message's fields: no channel of the board has such a device."""
        self._problems.add(f"{self._path}: {self._topic_of[number]}", str(error), bad=False)

    def _source(self, source: str) -> list[tuple[int, Want]] | None:
        """Return the channels of a source; None if the recording cannot have it."""
        name, _, path = source.partition(":")
        topic, field = name.removeprefix("/"), path
        if source in WHOLE or is_board(source):
            topic, field = WHOLE[name]
        channels = self._by_topic.get(topic)
        if channels is None:
            self._problems.add(
                f"{self._path}: {topic}", f"not recorded: what rests on {source} is unknown", bad=False
            )
            return None
        if len({channel.type_name for channel in channels}) > 1:
            kinds = ", ".join(sorted({channel.type_name for channel in channels}))
            self._problems.add(f"{self._path}: {topic}", f"recorded with several types: {kinds}", bad=False)
        if not field:
            return [(channel.number, (source, None)) for channel in channels]
        wants: list[tuple[int, Want]] = []
        for channel in channels:
            try:
                wants.append((channel.number, (source, self._extract(channel, field, source))))
            except Exception as error:  # noqa: BLE001  # a type that cannot be parsed: that topic only
                reason = f"{source}: the type {channel.type_name} cannot be used: {error}"
                self._problems.add(f"{self._path}: {topic}", reason, bad=True)
        return wants or None

    def _extract(self, channel: Channel, field: str, source: str) -> Callable[[bytes], Any]:
        from robomend_batch.logs.columns import compile_column
        from robomend_batch.logs.fields import compile_field, plain

        store = self._store(channel)
        unpack = store.deserialize_cdr if channel.cdr else store.deserialize_ros1
        name = channel.type_name
        if is_board(source):
            return lambda data: measured(source, plain(getattr(unpack(data, name), field)))
        if source in WHOLE:
            return lambda data: plain(getattr(unpack(data, name), field))
        column = compile_column(store.fielddefs, name, field, cdr=channel.cdr)
        if column is not None:
            self._columns[channel.number, source] = column
        return compile_field(
            store.fielddefs, name, field, cdr=channel.cdr, whole=lambda data: unpack(data, name)
        )

    def _by_header(self) -> None:
        """Take the times of messages from their headers, where they have one."""
        from robomend_batch.logs.fields import compile_field
        from robomend_client.bridges.unpacking import NoField

        for number, wants in self.of.items():
            (channel,) = (c for some in self._by_topic.values() for c in some if c.number == number)
            try:
                store = self._store(channel)
                seconds, nanoseconds = (
                    compile_field(
                        store.fielddefs,
                        channel.type_name,
                        f"header.stamp.{part}",
                        cdr=channel.cdr,
                        whole=_no_need,
                    )
                    for part in ("sec", "nanosec")
                )
            except NoField:
                place = f"{self._path}: {channel.topic}"
                self._problems.add(place, "no header: its times are the recorder's", bad=False)
            except Exception as error:  # noqa: BLE001  # a type that cannot be parsed: that topic only
                self.unreadable(number, error)
            else:
                self.channels[number] = True
                self.stamps[number] = _stamp(seconds, nanoseconds)
                self.of[number] = wants

    def _store(self, channel: Channel) -> Any:
        store = self._types.get(channel.type_name)
        if store is None:
            store = self._types[channel.type_name] = store_of(channel)
        return store


def _values(column: Column, stretch: Together, number: int) -> Any:
    return column(*stretch.bodies(number))


def _stamp(seconds: Callable[[bytes], Any], nanoseconds: Callable[[bytes], Any]) -> Callable[[bytes], int]:
    return lambda data: int(seconds(data)) * SECOND + int(nanoseconds(data))


def store_of(channel: Channel) -> Any:
    """Return a typestore that knows a channel's type; rosbags raises whatever if it cannot be parsed."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    text, name = channel.definition, channel.type_name
    store = get_typestore(Stores.EMPTY if text else Stores.LATEST)
    if text:
        store.register(get_types_from_idl(text) if channel.idl else get_types_from_msg(text, name))
    if name not in store.fielddefs:
        raise ValueError("it is not defined")
    return store


def _no_need(data: bytes) -> Any:
    raise ValueError("a header is at the beginning of a message")
