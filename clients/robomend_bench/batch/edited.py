"""Recordings of real robots, in which faults are put by editing: is each told, in its time, and nothing else?

    recording ──► first half ──► learn ──► model and observers, and for a number of each topic two by hand
              └─► the rest ────► as it is: every fault that is told is a false alarm
                        └──────► a topic dropped, thinned, frozen or ramped for a while, one in each copy

So jitter and values are real, and the truth is known. The two by hand are the ones that a person would write
for a sensor: it has a range, and it does not stand still for longer than it does. Which faults can be told at
all is decided by the unedited recording alone (below).

A fault is told when the edited half first shows of its topic what the unedited one has not shown since the
fault began: whatever differs there is the fault's doing.
"""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from robomend.errors import BackendError
from robomend_batch.learn.gathering import number_fields
from robomend_bench.batch.drives import BEGIN_S
from robomend_bench.batch.learning import episodes, faulty

# --- the messages of a ROS 1 recording, read whole, changed in a field, and written as a recording again.


@dataclass(frozen=True, slots=True)
class Message:
    """A message of a recording."""

    time_ns: int
    connection: Any
    data: bytes


def read(recording: Path) -> list[Message]:
    """Return the messages of a recording, in the order of time; BackendError if it cannot be read."""
    try:
        with Reader(recording) as reader:
            found = [Message(time_ns, of, bytes(data)) for of, time_ns, data in reader.messages()]
    except Exception as error:  # rosbags raises whatever of damaged files
        raise BackendError(f"cannot be read: {error}") from error
    if len(found) < 2:
        raise BackendError("there are no messages in it")
    return found


def write(file: Path, messages: Sequence[Message]) -> Path:
    """Write messages as a recording, each with its publisher."""
    with Writer(file) as writer:
        ours: dict[int, Any] = {}
        for message in messages:
            theirs = message.connection
            if theirs.id not in ours:
                ours[theirs.id] = writer.add_connection(
                    theirs.topic,
                    theirs.msgtype,
                    msgdef=theirs.msgdef.data,
                    md5sum=theirs.digest,
                    callerid=theirs.ext.callerid,
                )
            writer.write(ours[theirs.id], message.time_ns, message.data)
    return file


class Change:
    """A field of messages, read and replaced."""

    def __init__(self, connection: Any, path: str) -> None:
        self._type = connection.msgtype
        self._store = types_of(connection)
        *self._within, self._name = path.split(".")

    def value(self, data: bytes) -> float:
        """Return the field of a message."""
        return float(getattr(self._holder(self._store.deserialize_ros1(data, self._type)), self._name))

    def put(self, data: bytes, value: float) -> bytes:
        """Return the message with another value."""
        message = self._store.deserialize_ros1(data, self._type)
        setattr(self._holder(message), self._name, value)
        return bytes(self._store.serialize_ros1(message, self._type))

    def _holder(self, message: Any) -> Any:
        for name in self._within:
            message = getattr(message, name)
        return message


_STORES: dict[str, Any] = {}


def types_of(connection: Any) -> Any:
    """Return a typestore that knows a connection's type; rosbags raises whatever if it cannot be parsed."""
    key = f"{connection.msgtype} {connection.digest}"
    if key not in _STORES:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        _STORES[key] = store
    return _STORES[key]


# --- which faults of a topic can be told by whoever knows the recording without them alone.
#
#     dropped    the fault lasts twice as long as the longest pause of the healthy part, at least
#     thinned    no stretch of the healthy part that lasts a quarter of the fault has fewer than SCARCE of the
#                messages that such stretches usually have: half of them might be missing there anyhow
#     frozen     the fault lasts twice as long as the number stands still in the healthy part, at least
#     ramped     the range of the first half of the healthy part, and as much again on either side, holds in
#                its second half: else it is not the range of the number
#
# And of what there is nothing nothing can be taken, or changed: without the fault, the topic has SCARCE of
# its usual messages in the fault's time, at least.
#
# Nothing here knows what was learned, or what an observer can do.

Floats = NDArray[np.float64]

LONGER = 2.0
PARTS = 4
SCARCE = 0.6


def why_not(
    kind: str, times_s: Floats, numbers: Floats, fault_s: float, left_hz: float | None = None
) -> str | None:
    """Return why a fault cannot be told; None: it can.

    Args:
        kind: dropped, thinned, frozen or ramped.
        times_s: of the topic's messages in the healthy part, from its beginning to its end, sorted.
        numbers: of the field that is edited, one a message; none where nothing is.
        fault_s: how long it lasts.
        left_hz: messages a second that there are in its time without it; None: as usual.
    """
    usual_hz = (len(times_s) - 1) / float(np.ptp(times_s))
    if left_hz is not None and left_hz < SCARCE * usual_hz:
        return f"{left_hz / usual_hz:.0%} of the usual messages are there by themselves"
    if kind == "dropped":
        longest_s = float(np.diff(times_s).max(initial=0.0))
        return f"pauses of {longest_s:.1f} s" if LONGER * longest_s > fault_s else None
    if kind == "thinned":
        share = scarcest(times_s, fault_s / PARTS)
        return f"down to {share:.0%} of the usual messages" if share < SCARCE else None
    if kind == "frozen":
        still_s = longest_standstill(times_s, numbers)
        return f"stands still for {still_s:.1f} s" if LONGER * still_s > fault_s else None
    if kind == "ramped":
        first, second = np.array_split(numbers, 2)
        span = float(np.ptp(first))
        beyond = max(float(second.max() - first.max()), float(first.min() - second.min()))
        return "its range was not seen" if beyond > span else None
    return None


def scarcest(times_s: Floats, part_s: float) -> float:
    """Return how many messages the emptiest part of so long has, as a share of the usual one."""
    begins = np.arange(times_s[0], times_s[-1] - part_s, part_s / 10)
    if not len(begins):
        return 0.0
    counts = np.searchsorted(times_s, begins + part_s) - np.searchsorted(times_s, begins)
    usual = float(np.median(counts))
    return float(counts.min()) / usual if usual else 0.0


def longest_standstill(times_s: Floats, numbers: Floats) -> float:
    """Return how long a number stays what it is, at most, from its first message to the last one."""
    begins = np.flatnonzero(np.diff(numbers, prepend=np.nan) != 0)
    ends = np.append(begins[1:], len(numbers)) - 1
    return float((times_s[ends] - times_s[begins]).max(initial=0.0))


EDITS = ("dropped", "thinned", "frozen", "ramped")
"""Of a topic nothing comes; half comes; a number stands still; a number grows."""

FAULT = 0.35, 0.75
"""From where to where of the rest."""

PER_HOUR = 10.0
"""False alarms that are meant: what less than a minute of healthy data allows to be told apart."""

HAND = "edited"
"""How the observers by hand are called."""

AFTER_S = 20.0
"""So long after its end a fault may still be told."""

GROWS = 0.95
"""A number of which more of the steps have one sign is a clock, or counts: it has no range."""


@dataclass(frozen=True)
class Watched:
    """A topic that the draft watches."""

    topic: str
    node: str
    number: str | None = None  # the field that is edited, and watched by hand; None: the topic has none
    low: float = 0.0
    high: float = 0.0
    still_s: float = 0.0  # it stands so long by itself
    interval_s: float = 0.0
    name: str = ""  # of the observers by hand

    @property
    def span(self) -> float:
        return self.high - self.low

    @property
    def edits(self) -> tuple[str, ...]:
        """Which of EDITS can be noticed."""
        return EDITS if self.number else EDITS[:2]


@dataclass
class Edited:
    """What came out over all recordings."""

    recordings: int = 0
    unedited_s: float = 0.0
    refused: list[str] = field(default_factory=list)  # recordings that nothing can be learned from, and why
    planted: Counter[str] = field(default_factory=Counter)
    tellable: Counter[str] = field(default_factory=Counter)  # of these, what the recording allows to tell
    found: Counter[str] = field(default_factory=Counter)  # told of its topic, in its time, its node a suspect
    told: Counter[str] = field(default_factory=Counter)  # of those that can be told
    missed: list[str] = field(default_factory=list)
    delays_s: list[float] = field(default_factory=list)
    false_alarms: Counter[str] = field(default_factory=Counter)  # of what was learned, and of the two by hand
    alarms: list[str] = field(default_factory=list)  # of which recording, by what

    def json(self) -> dict[str, Any]:
        """Return all figures."""
        delays = sorted(self.delays_s)
        return {
            "recordings": self.recordings,
            "unedited_s": round(self.unedited_s, 1),
            "refused": self.refused,
            "planted": dict(self.planted),
            "found": dict(self.found),
            "tellable": dict(self.tellable),
            "told": dict(self.told),
            "missed": self.missed,
            "false_alarms": dict(self.false_alarms),
            "alarms": self.alarms,
            "delay_s": {"median": delays[len(delays) // 2], "longest": delays[-1]} if delays else None,
        }


def measure(program: list[str], folder: Path, recordings: Sequence[Path]) -> Edited:
    """Return what is told of recordings, edited and as they are.

    Args:
        program: the command line of robomend-batch.
        folder: for the copies.
        recordings: of healthy robots with ROS 1 (.bag).
    """
    found = Edited()
    for number, recording in enumerate(recordings):
        mine = folder / f"recording{number}"
        mine.mkdir()
        try:
            _one(program, mine, recording, found)
        except BackendError as error:
            found.refused.append(f"{recording.name}: {error}")
    return found


def _one(program: list[str], folder: Path, recording: Path, found: Edited) -> None:
    messages = read(recording)
    begin_ns, end_ns = messages[0].time_ns, messages[-1].time_ns
    half_ns = (begin_ns + end_ns) // 2
    first = [message for message in messages if message.time_ns < half_ns]
    rest = [message for message in messages if message.time_ns >= half_ns]
    draft = folder / "draft"
    good = write(folder / "good.bag", first)
    _run(
        [*program, "learn", str(good), "-o", str(draft), "--false-alarms-per-hour", str(PER_HOUR), "--quiet"]
    )
    watched = watch(program, draft, good, first)
    start_ns, stop_ns = (half_ns + round(share * (end_ns - half_ns)) for share in FAULT)
    unedited = write(folder / "unedited.bag", rest)
    planted: dict[Path, tuple[Watched, str]] = {}
    for one in watched:
        for kind in one.edits:
            file = folder / f"{kind}-{len(planted)}.bag"
            planted[write(file, edited(rest, one, kind, start_ns, stop_ns))] = one, kind
    told = diagnosed(program, draft, [unedited, *planted])
    found.recordings += 1
    found.unedited_s += (end_ns - half_ns) / 1e9
    as_it_is = [one for one in told if one["log"] == str(unedited)]
    _count_alarms(found, recording.name, as_it_is)
    when_s = start_ns / 1e9 - BEGIN_S, stop_ns / 1e9 - BEGIN_S
    edited_s = (stop_ns - start_ns) / 1e9
    for file, (topic, kind) in planted.items():
        found.planted[kind] += 1
        left = sum(start_ns <= one.time_ns < stop_ns for one in _of(topic, rest)) / edited_s
        reason = _why_not(topic, kind, first, edited_s, left)
        found.tellable[kind] += reason is None
        at_s = first_told([one for one in told if one["log"] == str(file)], as_it_is, topic.node, when_s)
        if at_s is None:
            why = f" (cannot be told: {reason})" if reason else ""
            found.missed.append(f"{recording.name}: {topic.topic} {kind}{why}")
        else:
            found.found[kind] += 1
            found.told[kind] += reason is None
            found.delays_s.append(max(0.0, at_s - when_s[0]))


def _why_not(
    topic: Watched, kind: str, healthy: Sequence[Message], fault_s: float, left_hz: float
) -> str | None:
    """Return why a fault of a topic cannot be told; None: it can."""
    mine = _of(topic, healthy)
    numbers: list[float] = []
    if kind in ("frozen", "ramped") and topic.number is not None:
        value = Change(mine[0].connection, topic.number).value
        numbers = [value(message.data) for message in mine]
    times_s = np.array([message.time_ns for message in mine], dtype=np.float64) / 1e9
    return why_not(kind, times_s, np.array(numbers), fault_s, left_hz)


def _of(topic: Watched, messages: Sequence[Message]) -> list[Message]:
    """Return the messages of a topic."""
    return [message for message in messages if message.connection.topic.strip("/") == topic.topic]


def _count_alarms(found: Edited, name: str, as_it_is: Sequence[dict[str, Any]]) -> None:
    """Count what is told of a recording without an edit."""
    for kind in ("learned", "by hand"):
        words_of = [
            [word for word in _wrong(one) if (HAND in word) == (kind == "by hand")] for one in as_it_is
        ]
        alarms = len(episodes([one for one, words in zip(as_it_is, words_of, strict=True) if words]))
        if alarms:
            found.false_alarms[kind] += alarms
            said = sorted({word for words in words_of for word in words})
            found.alarms.append(f"{name}: {alarms} {kind}, by {', '.join(said)}")


def first_told(
    intervals: Sequence[dict[str, Any]],
    as_it_is: Sequence[dict[str, Any]],
    node: str,
    when_s: tuple[float, float],
) -> float | None:
    """Return when an edit is told first: its node is a suspect, for what is not known without the edit.

    Args:
        intervals: of the edited recording.
        as_it_is: of the recording by itself.
        node: of the topic.
        when_s: from when to when it was edited.
    """
    for one in _within(intervals, when_s):
        for start_s, _, bad in faulty([one]):
            known = {
                word
                for other in _within(as_it_is, when_s)
                if other["start_ns"] <= max(one["start_ns"], (when_s[0] + BEGIN_S) * 1e9)
                for word in _wrong(other)
            }
            if not known.issuperset(_wrong(one)) and any(node in diagnosis for diagnosis in bad):
                return start_s
    return None


def _within(intervals: Sequence[dict[str, Any]], when_s: tuple[float, float]) -> list[dict[str, Any]]:
    """Return the intervals in which what is in this time can be told."""
    begin_s, end_s = when_s
    return [
        one
        for one in intervals
        if one["end_ns"] / 1e9 - BEGIN_S > begin_s and one["start_ns"] / 1e9 - BEGIN_S < end_s + AFTER_S
    ]


def _wrong(interval: dict[str, Any]) -> list[str]:
    """Return what was observed of an interval that a healthy robot does not show."""
    if interval["state"] not in ("faulty", "contradictory"):
        return []
    return [word for word in interval["observations"] if word.startswith(("not ", "const("))]


def diagnosed(program: list[str], draft: Path, logs: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the intervals of logs by a draft."""
    out = draft / "out"
    of_draft = ("-m", str(draft / "model.yaml"), "--observers", str(draft / "observers.yaml"))
    how = ("--quiet", "--workers", "0", "--overwrite")
    _run([*program, "run", *map(str, logs), *of_draft, "-o", str(out), *how])
    return [json.loads(line) for line in (out / "results.ndjson").read_text().splitlines()]


def edited(
    messages: Sequence[Message], topic: Watched, kind: str, start_ns: int, stop_ns: int
) -> list[Message]:
    """Return messages with a fault of a topic from one time to another."""
    found = []
    count = 0
    stood: float | None = None
    for message in messages:
        here = message.connection.topic.strip("/") == topic.topic and start_ns <= message.time_ns < stop_ns
        count += here
        if not here or (kind == "thinned" and count % 2):
            found.append(message)
        elif kind in ("frozen", "ramped"):
            assert topic.number is not None
            change = Change(message.connection, topic.number)
            value = stood = change.value(message.data) if stood is None else stood
            if kind == "ramped":
                grown = topic.span * (message.time_ns - start_ns) / 1e9
                value = change.value(message.data) + grown
            found.append(replace(message, data=change.put(message.data, value)))
    return found


def watch(program: list[str], draft: Path, good: Path, messages: Sequence[Message]) -> list[Watched]:
    """Add two observers for a number of each topic to a draft; return the topics that it watches.

    One that says of the healthy part that it is faulty is left out, as by whoever tries it there first.
    """
    model = yaml.safe_load((draft / "model.yaml").read_text())
    observers = yaml.safe_load((draft / "observers.yaml").read_text())
    node_of = {
        topic: name for name, node in model["nodes"].items() for topic in (node or {}).get("publishes", {})
    }
    topics = [topic for topic in sorted(observers.get("topics") or {}) if topic in node_of]
    if not topics:
        raise BackendError("no topic of it is watched")
    found = [
        numbered(Watched(topic, node_of[topic], name=f"{HAND}{place}_"), messages)
        for place, topic in enumerate(topics)
    ]
    while True:
        _write(draft, model, observers, found)
        said = {
            word
            for one in diagnosed(program, draft, [good])
            if one["state"] in ("faulty", "contradictory")
            for word in one["observations"]
        }
        kept = [
            replace(
                one,
                number=None if f"not ok({one.name}range)" in said else one.number,
            )
            for one in found
        ]
        if kept == found:
            return found
        found = kept


def _write(draft: Path, model: dict[str, Any], observers: dict[str, Any], watched: list[Watched]) -> None:
    """Write a draft with the observers of these topics' numbers, and what the model says of them."""
    more: dict[str, Any] = {}
    rules: list[str] = []
    values: dict[str, Any] = {}
    for one in watched:
        if one.number is None:
            continue
        source, value, span = f"{one.topic}:{one.number}", f"{one.name}value", f"{one.name}range"
        near = {"source": source, "low": one.low - one.span, "high": one.high + one.span}
        more[span] = {"kind": "property", **near, "agreeing": 3}
        rules.append(f"not ab({json.dumps(one.node)}) -> ok({span})")
        still = {"source": source, "slope": one.span * 1e-6, "window_s": max(1.0, 5 * one.interval_s)}
        more[value] = {"kind": "qualitative", **still, "debounce_s": max(1.0, LONGER * one.still_s)}
        values[value] = {"topic": one.topic, "field": one.number}
        rules.append(f"not ab({json.dumps(one.node)}) -> not const({value})")
    properties: dict[str, Any] = {name: {} for name in more if name not in values}
    observers = {**observers, "observers": {**(observers.get("observers") or {}), **more}}
    model = {
        **model,
        "properties": {**(model.get("properties") or {}), **properties},
        "values": {**(model.get("values") or {}), **values},
        "rules": [*(model.get("rules") or ()), *rules],
    }
    (draft / "model.yaml").write_text(yaml.safe_dump(model, sort_keys=False))
    (draft / "observers.yaml").write_text(yaml.safe_dump(observers, sort_keys=False))


def numbered(topic: Watched, good: Sequence[Message]) -> Watched:
    """Return a topic with the number of it that moves most often, if it has any."""
    messages = _of(topic, good)
    times_s = np.array([message.time_ns for message in messages], dtype=np.float64) / 1e9
    best, share = topic, 0.0
    for path, numbers in _numbers(messages):
        if not np.isfinite(numbers).all() or numbers.max() <= numbers.min():
            continue
        moves = np.sign(np.diff(numbers))
        moving = float(np.mean(moves != 0))
        if moving > share and abs(moves.sum()) < (2 * GROWS - 1) * np.abs(moves).sum():
            best, share = (
                replace(topic, number=path, low=float(numbers.min()), high=float(numbers.max())),
                moving,
            )
            best = replace(
                best,
                still_s=longest_standstill(times_s, numbers),
                interval_s=float(np.median(np.diff(times_s))),
            )
    return best


def _numbers(messages: Sequence[Message]) -> Iterator[tuple[str, np.ndarray[Any, np.dtype[np.float64]]]]:
    connection = messages[0].connection
    try:
        paths = number_fields(types_of(connection).fielddefs, connection.msgtype)
        for path in paths:
            value: Callable[[bytes], float] = Change(connection, path).value
            yield path, np.array([value(message.data) for message in messages])
    except Exception:  # noqa: BLE001  # a type that rosbags cannot parse has no numbers
        return


def _run(line: list[str]) -> None:
    done = subprocess.run(line, capture_output=True, text=True, timeout=1800, check=False)
    if done.returncode:
        raise BackendError(done.stderr.strip()[-300:] or f"ended with {done.returncode}")
