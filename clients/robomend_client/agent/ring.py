"""The last messages of the robot's topics, as they came, in bounded memory; and of them a recording (.mcap).

    message ──► last ones of its topic, for the freeze frame
            └─► switched on: those of the last `before_s` seconds ──► after a moment: a recording

Where memory does not hold all, the topic that takes most gives its oldest messages: of those the times stay,
so that a rate is still what it was. While a moment is open it gives its newest instead: what was there when
something turned bad is not pushed out by what came later.

A topic of which some messages were given up is two in the recording: TOPIC has the times of all, as messages
of the type Empty, and TOPIC/kept those that are whole. LOOKS has when nobody looked, and when the computer
was starved, so that who judges the messages again judges as it was judged then.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from robomend_client.observers import SECOND, Contact
from robomend_client.observers.recording import LOOKS, Looks

LAST = 3
"""Messages of a topic that a freeze frame has, at most."""

LARGE = 64 * 1024
"""Bytes of a message that is kept by itself only where it is recorded."""

OVERHEAD = 200
"""Bytes that a message takes beside its own, about."""

MOST_TOPICS = 1000
MOST_STAMPS = 100_000

MOST_LOOKS = 10_000

SLACK = 0.1
"""Of the memory, this much is made free at once."""

MARKS = "/robomend/moment"
"""A topic of the recording that says where it begins and ends: what is silent in between was."""


class TopicDescription(NamedTuple):
    """How the messages of a topic are to be read."""

    type: str  # sensor_msgs/msg/LaserScan
    schema: str  # its definition; nothing, where there is none
    schema_encoding: str  # ros2msg, ros1msg
    encoding: str  # cdr, ros1
    text: Callable[[bytes, int], str]
    """Returns a message as text, of so many characters at most; raises what its bytes make it."""


Describe = Callable[[Any], TopicDescription]
"""Called with what a feed told beside a message; from a thread."""

Tap = Callable[[str, int, bytes, Any], None]
"""Takes a message: its topic on the robot, when it was made, its bytes (none of one that was let go as it
came), and whatever its feed needs to describe it.
"""


class Kept(NamedTuple):
    """A message; `data` is None where it is too large to be kept."""

    time_ns: int
    data: bytes | None
    about: Any


@dataclass
class RingTopic:
    """What is kept of one topic."""

    name: str
    describe: Describe
    last: deque[Kept] = field(default_factory=lambda: deque(maxlen=LAST))
    whole: deque[Kept] = field(default_factory=deque)  # for the recording
    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=MOST_STAMPS))  # of those given up
    size: int = 0  # of `whole`


class Ring(Looks):
    """See the module."""

    def __init__(self, before_s: float, memory_bytes: int, *, record: bool) -> None:
        self.topics: dict[str, RingTopic] = {}
        self.size = 0
        self.record = record
        self._before_ns = int(before_s * SECOND)
        self._most = memory_bytes
        self._since_ns: int | None = None  # while a moment is open: what is younger stays
        self._newest_ns = 0
        self._looks: deque[dict[str, Any]] = deque()  # lines of the driver's recording
        self._holds: dict[tuple[str, str], dict[str, Any]] = {}  # of older ones, those that are still so

    def tap(self, describe: Describe) -> Tap:
        """Return what a feed hands its messages to."""

        def heard(topic: str, time_ns: int, data: bytes, about: Any) -> None:
            one = self.topics.get(topic)
            if one is None:
                if len(self.topics) >= MOST_TOPICS:
                    return
                one = self.topics[topic] = RingTopic(topic, describe)
            if time_ns < self._newest_ns - SECOND:
                self.forget()  # the clock went back
            self._newest_ns = max(self._newest_ns, time_ns)
            one.last.append(Kept(time_ns, data if 0 < len(data) <= LARGE else None, about))
            if self.record:
                self._keep(one, Kept(time_ns, data, about))

        return heard

    def hold(self, at_ns: int) -> None:
        """A moment begins: what is there stays."""
        self._since_ns = at_ns - self._before_ns

    def let_go(self) -> None:
        """The moment is over."""
        self._since_ns = None

    def forget(self) -> None:
        """Begin anew: these times are of another clock."""
        self._newest_ns = 0
        self.size = 0
        self._looks.clear()
        self._holds.clear()
        for one in self.topics.values():
            one.last.clear()
            one.whole.clear()
            one.stamps.clear()
            one.size = 0

    def write(self, line: dict[str, Any]) -> None:
        """Take down when nobody looked, and the like: see Looks."""
        if "at" not in line:
            self.forget()  # time begins again
            return
        looks = self._looks
        looks.append(line)
        oldest_ns = line["at"] - self._before_ns if self._since_ns is None else self._since_ns
        while looks and (looks[0]["at"] < oldest_ns or len(looks) > MOST_LOOKS):
            _is_so(self._holds, looks.popleft())

    def looks(self, since_ns: int, until_ns: int) -> list[dict[str, Any]]:
        """Return what there is of that within that time; what was so before is so from its beginning on."""
        holds, found = dict(self._holds), []
        for line in self._looks:
            if line["at"] < since_ns:
                _is_so(holds, line)
            elif line["at"] <= until_ns:
                found.append(line)
        return [*({**line, "at": since_ns} for line in holds.values()), *found]

    def recorded(self, since_ns: int, until_ns: int) -> list[Recorded]:
        """Return what there is of each topic within that time, to be written by a thread."""
        found = []
        for one in self.topics.values():
            whole = [kept for kept in one.whole if since_ns <= kept.time_ns <= until_ns]
            stamps = [time_ns for time_ns in one.stamps if since_ns <= time_ns <= until_ns]
            if whole or stamps:
                found.append(Recorded(one.name, one.describe, whole, sorted(stamps)))
        return found

    def _keep(self, one: RingTopic, kept: Kept) -> None:
        size = len(kept.data or b"") + OVERHEAD
        one.whole.append(kept)
        one.size += size
        self.size += size
        oldest_ns = kept.time_ns - self._before_ns if self._since_ns is None else self._since_ns
        while one.whole and one.whole[0].time_ns < oldest_ns:
            self._give(one, one.whole.popleft())
        while one.stamps and one.stamps[0] < oldest_ns:
            one.stamps.popleft()
        if self.size > self._most:
            self._make_room()

    def _make_room(self) -> None:
        held = self._since_ns is not None
        enough = self._most if held else self._most * (1 - SLACK)
        while self.size > enough:
            largest = max(self.topics.values(), key=lambda one: one.size)
            given = largest.whole.pop() if held else largest.whole.popleft()
            self._give(largest, given)
            largest.stamps.append(given.time_ns)

    def _give(self, one: RingTopic, kept: Kept) -> None:
        size = len(kept.data or b"") + OVERHEAD
        one.size -= size
        self.size -= size


def _is_so(holds: dict[tuple[str, str], dict[str, Any]], line: dict[str, Any]) -> None:
    """Take a line into what is so from then on."""
    if "starved" in line or "sight" in line:
        kind = "starved" if "starved" in line else "sight"
        if line.get("starved", line.get("sight") == Contact.LOST.value):
            holds[kind, line.get("of", "")] = line
        else:
            holds.pop((kind, line.get("of", "")), None)
    elif "publishers" in line:
        holds["publishers", line["of"]] = line


class Recorded(NamedTuple):
    """What there is of one topic."""

    name: str
    describe: Describe
    whole: list[Kept]
    stamps: list[int]  # of messages that are not


def write(
    file: Path,
    topics: Iterable[Recorded],
    looks: Iterable[dict[str, Any]],
    since_ns: int,
    until_ns: int,
    about: bytes,
) -> list[str]:
    """Write a recording; return what is to be said of it. For a thread: it takes a while.

    Args:
        looks: lines of the driver's recording.
        about: JSON that stands where it begins and ends.

    Raises:
        OSError: the disk is full, or cannot be written.
    """
    from mcap.writer import Writer

    notes = []
    with file.open("wb") as out:
        writer = Writer(out)
        writer.start(profile="", library="robomend")
        channels = _Channels(writer)
        messages: list[tuple[int, int, bytes]] = []
        marks = writer.register_channel(MARKS, "json", 0)
        messages += ((since_ns, marks, about), (until_ns, marks, about))
        for one in topics:
            found = one.whole
            if not one.stamps:
                messages += ((kept.time_ns, channels.of(one, kept), kept.data or b"") for kept in found)
                continue
            times = sorted([*one.stamps, *(kept.time_ns for kept in found)])
            cdr = not found or one.describe(found[0].about).encoding == "cdr"
            empty = channels.empty(one.name, cdr=cdr)
            messages += ((time_ns, empty, EMPTY_CDR if cdr else b"") for time_ns in times)
            messages += ((kept.time_ns, channels.of(one, kept, "/kept"), kept.data or b"") for kept in found)
            notes.append(
                f"recorded of {one.name}: {len(found)} of {len(times)} messages, of the others the time"
            )
        looked = writer.register_channel(LOOKS, "json", 0)
        # Behind the messages of their time: a lapse begins with the last one that was taken in.
        messages += ((line["at"], looked, json.dumps(line).encode()) for line in looks)
        messages.sort(key=lambda message: message[0])
        for time_ns, number, data in messages:
            writer.add_message(number, time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # the library says no types of it
    return notes


EMPTY_CDR = b"\x00\x01\x00\x00\x00"
EMPTY = "std_msgs/msg/Empty"


class _Channels:
    """The channels of a recording, each made when it is needed."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._known: dict[tuple[str, str, str], int] = {}
        self._schemas: dict[tuple[str, str], int] = {}

    def of(self, one: Recorded, kept: Kept, more: str = "") -> int:
        described = one.describe(kept.about)
        return self._channel(
            one.name + more, described.type, described.schema, described.schema_encoding, described.encoding
        )

    def empty(self, topic: str, *, cdr: bool) -> int:
        if cdr:
            return self._channel(topic, EMPTY, "", "ros2msg", "cdr")
        return self._channel(topic, EMPTY.replace("/msg", ""), "", "ros1msg", "ros1")

    def _channel(self, topic: str, kind: str, definition: str, schema_encoding: str, encoding: str) -> int:
        key = (topic, kind, definition)
        if key not in self._known:
            schema = (kind, definition)
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(
                    kind, schema_encoding, definition.encode()
                )
            self._known[key] = self._writer.register_channel(topic, encoding, self._schemas[schema])
        return self._known[key]
