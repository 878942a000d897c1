"""Messages that come at their rate, and say nothing new: a value that stands still, a stamp that is old.

    changing   ok(z) while a value changes within `still_s`            stands still at 0.42 since 23:04:10 UTC
    age        ok(age,scan) while stamps are as young as they should   stamp 3 h behind

A value that nobody sends stands nowhere: the rate of its topic is another observer's.
"""

from __future__ import annotations

import reprlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robomend_client.counts import first_few
from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers.base import NOTHING, SECOND, Evidence, WrongKind, ns, number, positive
from robomend_client.observers.incidents import for_s
from robomend_client.observers.reading import JudgedReadings, Readings
from robomend_client.readings import Reading, Symptom

SHOWN = 3
"""Numbers of an array."""

STAMP = "header.stamp.sec,header.stamp.nanosec"

FIRST_CLOCK_S = 10**9
"""Stamps before 2001 are of no clock: not set, or of a simulation that has just begun."""


@dataclass(frozen=True)
class Stillness:
    """When a value stands still.

    Attributes:
        still_s: so many seconds without a change are bad.
        tolerance: what differs by no more has not changed, in units of the value.
        lifetime_s: when no sample came for so many seconds, nothing is said.
        interval_s: how often a sample comes, in seconds; only for the delays that are declared.
    """

    still_s: float = 10.0
    tolerance: float = 0.0
    lifetime_s: float = 5.0
    interval_s: float = 1.0

    def __post_init__(self) -> None:
        positive(still_s=self.still_s, lifetime_s=self.lifetime_s, interval_s=self.interval_s)
        if not 0 <= self.tolerance < float("inf"):
            raise ValueError(f"tolerance must not be below 0, but is {self.tolerance:g}")


class ChangingObserver:
    """Watches whether a value changes: a number, a text, or a list of them."""

    def __init__(self, atom: str, source: str, expected: Stillness | None = None) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(moves,imu)`; `yaw` is short for ok(yaw); by default the entry's
                name.
            source: where the value comes from, e.g. `imu:linear_acceleration.z`, `scan:ranges[:20]`.
            expected: of its changes.
        """
        self._expected = expected or Stillness()
        self.atoms = (parse_atom(atom),)
        self.sources = frozenset((source,))
        self._value_of = source.partition(":")[2] or source
        self.period_ns = 0
        self.detection_s = self._expected.still_s + self._expected.interval_s
        self.settling_s = 2 * self._expected.still_s + self._expected.interval_s
        self._still_ns, self._life_ns = ns(self._expected.still_s), ns(self._expected.lifetime_s)
        self._signs = {good: (Literal(self.atoms[0], good),) for good in (True, False)}
        self._since_ns: int | None = None  # when the value that stands was first read, also before a reset
        self._value: object = None
        self._newest_ns = -1
        self.reset(0)

    def reset(self, time_ns: int) -> None:
        if time_ns < self._newest_ns:
            self._since_ns = None
        self._began_ns: int | None = None  # the first sample since then
        self._changed_ns: int | None = None  # the newest change since then
        self._changes = 0  # since then; one jump is no sign of life

    def feed(self, source: str, time_ns: int, value: object) -> None:
        if isinstance(value, float):
            value = number(value)
        if self._newest_ns >= 0 and time_ns - self._newest_ns >= self._life_ns:
            self._since_ns = self._began_ns = self._changed_ns = None  # nobody knows what it was meanwhile
            self._changes = 0
        self._newest_ns = time_ns
        if self._began_ns is None:
            self._began_ns = time_ns
        if self._since_ns is None or not self._same(value):
            if self._since_ns is not None:
                self._changed_ns = time_ns
                self._changes = min(self._changes + 1, 2)
            self._value, self._since_ns = value, time_ns

    def _same(self, value: object) -> bool:
        known = self._value
        if self._expected.tolerance and isinstance(value, (int, float)) and isinstance(known, (int, float)):
            return abs(value - known) <= self._expected.tolerance
        return bool(value == known)

    def due_ns(self) -> int | None:
        return None if self._began_ns is None else self._newest_ns + self._life_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        if self._began_ns is None or now_ns - self._newest_ns >= self._life_ns:
            return NOTHING
        if self._newest_ns - self._began_ns < self._still_ns:
            return NOTHING  # one that stands would not have been seen to stand yet
        if self._stands():
            return self._signs[False]
        return self._signs[True] if self._changes > 1 else NOTHING

    def _stands(self) -> bool:
        """Return whether it had stood for too long at the newest sample."""
        assert self._began_ns is not None
        return self._newest_ns - max(self._began_ns, self._changed_ns or 0) >= self._still_ns

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        assert self._since_ns is not None
        assert self._began_ns is not None
        shown = _shown(self._value)
        if self._changed_ns is not None and not self._stands():
            within = f"changes within {self._expected.still_s:g} s"
            value = self._value if isinstance(self._value, (int, float, str)) else shown
            return Evidence(self._changed_ns, None, Reading(value, "", within))
        since = time.strftime("%H:%M:%S", time.gmtime(self._since_ns / SECOND))
        told = f"{self._value_of} stands still at {shown} since {since} UTC"
        limit = f"should change within {self._expected.still_s:g} s"
        begins_ns = max(self._began_ns, self._changed_ns or 0, self._newest_ns - self._still_ns)
        return Evidence(begins_ns, self._changed_ns, Reading(told, "", limit, Symptom.STILL))


def _shown(value: object) -> str:
    """Return a value as a reading has room for it."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Sequence) and value and all(isinstance(one, (int, float)) for one in value):
        return first_few([f"{one:.4g}" for one in value], SHOWN)
    return reprlib.repr(value)


@dataclass(frozen=True)
class Age:
    """How old stamps may be.

    Attributes:
        most_s: a stamp may be so many seconds behind the message's time.
        ahead_s: and so many seconds ahead of it.
    """

    most_s: float = 2.0
    ahead_s: float = 2.0

    def __post_init__(self) -> None:
        positive(most_s=self.most_s, ahead_s=self.ahead_s)


class AgeObserver(JudgedReadings):
    """Watches the stamps in the messages of one topic against the time at which they were sent."""

    def __init__(
        self,
        atom: str,
        topic: str | None = None,
        source: str | None = None,
        expected: Age | None = None,
        readings: Readings | None = None,
    ) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(age,scan)`; by default the entry's name.
            topic: whose header.stamp is looked at; by default the last name in the atom.
            source: where the stamp comes from instead: `path:stamp.sec,stamp.nanosec`, or a number of
                seconds.
            expected: how old it may be.
            readings: how many make a verdict; of `agreeing` one that is left at 1 is 3.
        """
        self._expected = expected or Age()
        readings = readings or Readings()
        topic = (topic or parse_atom(atom).args[-1]).strip("/")
        super().__init__(
            atom,
            source or f"{topic}:{STAMP}",
            replace(readings, agreeing=readings.agreeing if readings.agreeing > 1 else 3),
        )

    def feed(self, source: str, time_ns: int, value: object) -> None:
        seconds, rest = value, 0
        if isinstance(value, Mapping):
            if len(value) != 2:
                raise WrongKind("a stamp (its seconds and nanoseconds) is", value)
            seconds, rest = value.values()
        stamped_ns = round(number(seconds) * SECOND) + int(number(rest))
        if stamped_ns < FIRST_CLOCK_S * SECOND:
            self._judgement.reset()  # of no clock
            return
        age_ns = time_ns - stamped_ns
        good = -ns(self._expected.ahead_s) <= age_ns <= ns(self._expected.most_s)
        self._judgement.add(time_ns, good, read=age_ns)

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        age_ns = self._judgement.read
        assert isinstance(age_ns, int)
        told = f"stamp {for_s(abs(age_ns))} {'behind' if age_ns >= 0 else 'ahead'}"
        most_s = self._expected.most_s if age_ns >= 0 else self._expected.ahead_s
        reading = Reading(told, "", f"at most {most_s:g} s", Symptom.OLD if self._judgement.bad else None)
        return self._judgement.evidence._replace(reading=reading)


def suggested(topic: str, fields: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the entry of `observers:` that a topic suggests whose messages have a stamp that was heard.

    Args:
        topic: with its slash, as ROS has it.
        fields: what was heard of a message: a path (STAMP) and its value.
    """
    heard = fields.get(STAMP)
    if not isinstance(heard, Mapping) or not any(
        isinstance(one, int) and one >= FIRST_CLOCK_S for one in heard.values()
    ):
        return {}
    name = topic.strip("/")
    return {f"ok(age,{name})": {"kind": "age", "topic": name}}
