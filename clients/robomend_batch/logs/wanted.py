"""What of a recording is wanted: of some channels the times suffice, of others a field is unpacked."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robomend_batch.logs.chunk import Chunk, in_order
from robomend_batch.logs.recorded import Channel, Message
from robomend_batch.problems import Problems
from robomend_client.bridges.measured import is_board, measured
from robomend_client.bridges.names import Names
from robomend_client.observers.base import SECOND
from robomend_client.observers.driver import Driver
from robomend_client.observers.kinds import ObserverSpec
from robomend_client.observers.recording import LOOKS

if TYPE_CHECKING:
    from robomend_batch.logs.fields import Column

WHOLE = {"diagnostics": ("diagnostics", "status"), "board": ("board_measurments", "channel")}
"""Sources that are more than times or a number: their topic, and the field that observers get, as the bridges
have it.
"""

STATUSES = "diagnostic_msgs/msg/DiagnosticArray"

Want = tuple[str, Callable[[bytes], Any] | None]
"""A source, and what makes its value of a message; None: its times suffice."""


class Wants:
    """What of a recording is wanted, and by which observers."""

    def __init__(
        self,
        channels: Iterable[Channel],
        specs: Iterable[ObserverSpec],
        path: Path,
        problems: Problems,
        by_header: bool,
        names: Iterable[Names] = (),
    ) -> None:
        specs = tuple(specs)
        self._names = tuple(names)
        self._statuses = {source for spec in specs if spec.kind == "diagnostic" for source in spec.sources}
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
        self.looks: set[int] = set()
        """Channels with lines of when the agent that recorded it did not look (LOOKS)."""
        self.publishers: dict[int, tuple[str, str]] = {}
        """Channel -> source and node, of topics of which somebody asks who publishes them."""
        found: dict[str, list[tuple[int, Want]] | None] = {}
        self.specs = []
        for spec in specs:
            if not self._is_recorded(spec):
                continue
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
        elif self.specs:
            self.looks = {channel.number for channel in self._by_topic.get(LOOKS.removeprefix("/"), ())}
            for number in self.looks:
                self.of[number], self.channels[number] = [], True

    def _is_recorded(self, spec: ObserverSpec) -> bool:
        """Return whether a recording can have what an observer of the robot's graph asks for; say why not."""
        if spec.kind == "qos":
            reason = "no recording has the qualities of service of who listens"
        elif spec.kind == "publishers":
            of = {source: self._channels(source, source) or () for source in spec.sources}
            named = {one.number: (source, one.publisher) for source in of for one in of[source]}
            if all(node for _, node in named.values()):  # a topic that is not there is told as any other
                self.publishers.update(named)
                return True
            reason = "this recording does not say who publishes it; those of ROS 1 do"
        else:
            return True
        self._problems.add(f"{self._path}: {spec.name}", f"{reason}: it is unknown", bad=False)
        return False

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

    def taken(self, stretch: Chunk, driver: Driver) -> bool:
        """Return whether a driver takes in a stretch at once; else nothing of it was taken in."""
        samples: dict[str, tuple[Any, Callable[[], Any] | None]] = {}
        if not (self.publishers.keys() | self.looks).isdisjoint(stretch.times_ns):
            return False
        for number, times_ns in stretch.times_ns.items():
            for source, extract in self.of[number]:
                column = self._columns.get((number, source))
                if source in samples or (extract is not None and column is None):
                    return False
                samples[source] = times_ns, column and partial(_values, column, stretch, number)
        if not samples or not all(in_order(times_ns) for times_ns, _ in samples.values()):
            return False
        together = np.sort(np.concatenate([*stretch.times_ns.values()]))
        first_ns, gap_ns = int(together[0]), int((together[1:] - together[:-1]).max(initial=0))
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
        channels = self._channels(topic, source)
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

    def _channels(self, topic: str, source: str) -> list[Channel] | None:
        """Return the channels of a topic: as the bridges call it, or as it is."""
        called = [names.ros(topic).removeprefix("/") for names in self._names]
        in_order = [topic, *called] if source == "diagnostics" else [*called, topic]  # as the bridges have it
        return next((self._by_topic[name] for name in in_order if name in self._by_topic), None)

    def _extract(self, channel: Channel, field: str, source: str) -> Callable[[bytes], Any]:
        from robomend_batch.logs.fields import compile_column, compile_field, plain, plain_cdr

        store = self._store(channel)
        name = channel.type_name

        def unpack(data: bytes, name: str) -> Any:
            return (
                store.deserialize_cdr(plain_cdr(data), name)
                if channel.cdr
                else store.deserialize_ros1(data, name)
            )

        if is_board(source):
            return lambda data: measured(source, plain(getattr(unpack(data, name), field)))
        if source in WHOLE or (source in self._statuses and name == STATUSES):
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
                        exact=False,
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


def _values(column: Column, stretch: Chunk, number: int) -> Any:
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
