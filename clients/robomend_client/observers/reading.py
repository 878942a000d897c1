"""Observers that judge one reading at a time, good or bad: the base of the property observer, and of your
own.

    class NotTooHot(ReadingObserver):
        def __init__(self, limit: float = 60.0, **rest: Any) -> None:
            super().__init__(**rest)
            self.limit = limit

        def judge(self, value: object) -> bool:
            return number(value) < self.limit

The annotated parameters are its keys in the agent's file. A function from a value to good, bad or None (this
reading says nothing) will do as well: FunctionObserver makes an observer of it.

From readings to a verdict that lasts:

    readings   g g g b g g b b b b b g g g
    agreeing=3     ok ········· not ok ······ ok        a spike is no fault, and one good reading no recovery

A verdict needs `agreeing` readings in a row that say the same, over `debounce` at least. It lasts until as
many say the opposite, and is unknown when the newest reading is older than `lifetime`.
"""

from __future__ import annotations

import reprlib
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers.base import NOTHING, Evidence, ns, number, positive
from robomend_client.readings import Reading, Symptom


class Judgement:
    """What is held of one thing, by the readings that speak for and against it."""

    __slots__ = (
        "_agreeing",
        "_debounce_ns",
        "_evidence",
        "_good_ns",
        "_lifetime_ns",
        "_newest_ns",
        "_read",
        "_streak",
        "_streak_ns",
        "_times",
        "_verdict",
    )

    def __init__(self, agreeing: int = 1, debounce_ns: int = 0, lifetime_ns: int | None = None) -> None:
        self._agreeing = agreeing
        self._debounce_ns = debounce_ns
        self._lifetime_ns = lifetime_ns
        self._times: deque[int] = deque(maxlen=agreeing)  # of the newest readings that say the same
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        self._verdict: bool | None = None
        self._streak: bool | None = None
        self._streak_ns = 0
        self._newest_ns: int | None = None
        self._good_ns: int | None = None
        self._evidence = Evidence(0)
        self._read: dict[bool, object] = {}  # what the newest good reading was, and the newest bad one
        self._times.clear()

    def add(self, time_ns: int, good: bool, since_ns: int | None = None, read: object = None) -> None:
        """Take in a reading; `since_ns` is the beginning of what it was made of, where that is a span, and
        `read` what was read.
        """
        times = self._times
        if good is not self._streak:
            self._streak = good
            self._streak_ns = time_ns
            times.clear()
        times.append(time_ns if since_ns is None else since_ns)
        self._newest_ns = time_ns
        self._read[good] = read
        if len(times) == self._agreeing and time_ns - self._streak_ns >= self._debounce_ns:
            onset_ns = None if good else self._good_ns
            self._verdict = good
            self._evidence = Evidence(min(times[0], time_ns - self._debounce_ns), onset_ns)
        if good:
            self._good_ns = time_ns

    def at(self, now_ns: int) -> bool | None:
        """Return the verdict; None while nothing is known."""
        due_ns = self.due_ns()
        return None if due_ns is not None and now_ns >= due_ns else self._verdict

    def goes_on(self, times_ns: Any, until_ns: int) -> bool:
        """Return whether good readings at these times, an array, leave a good verdict that lasts as it is."""
        if self._verdict is not True or self._streak is not True or self._newest_ns is None:
            return False
        life_ns = self._lifetime_ns
        if life_ns is None:
            return True
        gaps_ns = times_ns[1:] - times_ns[:-1]
        longest_ns = max(int(times_ns[0]) - self._newest_ns, until_ns - int(times_ns[-1]))
        return longest_ns < life_ns and (not len(gaps_ns) or int(gaps_ns.max()) < life_ns)

    @property
    def evidence(self) -> Evidence:
        """What the verdict rests on."""
        return self._evidence

    @property
    def bad(self) -> bool:
        """Whether the verdict is bad, be it still of use or not."""
        return self._verdict is False

    @property
    def read(self) -> object:
        """What the newest reading was that says what the verdict does."""
        return None if self._verdict is None else self._read.get(self._verdict)

    @property
    def good_ns(self) -> int | None:
        """The newest good reading."""
        return self._good_ns

    def due_ns(self) -> int | None:
        """Return when the verdict turns unknown by itself."""
        if self._verdict is None or self._lifetime_ns is None or self._newest_ns is None:
            return None
        return self._newest_ns + self._lifetime_ns


@dataclass(frozen=True)
class Readings:
    """How readings become a verdict that lasts.

    Attributes:
        agreeing: readings in a row that say the same, for a verdict.
        debounce_s: for how long they must say so, in seconds.
        lifetime_s: a reading that is older than so many seconds says nothing.
        interval_s: how often a reading comes, in seconds; only for the delays that are declared.
        latched: whether the topic is: what was read once holds until it is read anew, also over a reset.
    """

    agreeing: int = 1
    debounce_s: float = 0.0
    lifetime_s: float = 5.0
    interval_s: float = 1.0
    latched: bool = False

    def __post_init__(self) -> None:
        positive(lifetime_s=self.lifetime_s, interval_s=self.interval_s)
        if not 1 <= self.agreeing <= 10_000:
            raise ValueError(f"agreeing must be from 1 to 10000, not {self.agreeing}")
        if not 0 <= self.debounce_s <= 86400:
            raise ValueError(f"debounce_s must be from 0 to 86400, not {self.debounce_s:g}")

    def judgement(self) -> Judgement:
        life_ns = None if self.latched else ns(self.lifetime_s)
        return Judgement(self.agreeing, ns(self.debounce_s), life_ns)

    @property
    def delay_s(self) -> float:
        """From a step of the value to the verdict, at most."""
        return max(self.agreeing * self.interval_s, self.debounce_s + self.interval_s)


class JudgedReadings:
    """Says whether the readings of one source are good; a subclass's `feed` judges them."""

    unit = ""
    """What its readings are measured in, for people."""

    limit = ""
    """What they are held against, for people: "at least 22"."""

    def __init__(self, atom: str, source: str, readings: Readings | None = None) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(CPU,hokuyo_node)`; `temperature` is short for ok(temperature);
                by default the entry's name.
            source: where its readings come from, e.g. `motor:temperature`.
            readings: how many make a verdict.
        """
        readings = readings or Readings()
        self.atoms: tuple[Atom, ...] = (parse_atom(atom),)
        self.sources = frozenset((source,))
        self.period_ns = 0
        self.detection_s = self.settling_s = readings.delay_s
        self._signs = {good: (Literal(self.atoms[0], good),) for good in (True, False)}
        self._judgement = readings.judgement()
        self.latched = readings.latched

    def reset(self, time_ns: int) -> None:
        if not self.latched:  # it would not come again
            self._judgement.reset()

    def due_ns(self) -> int | None:
        return self._judgement.due_ns()

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        good = self._judgement.at(now_ns)
        return NOTHING if good is None else self._signs[good]

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        return self._judgement.evidence._replace(reading=self.measured(self._judgement.read))

    def measured(self, value: object) -> Reading:
        """Return what was read, as people are told it."""
        bad = self._judgement.bad
        shown = value if isinstance(value, (int, float, str)) else reprlib.repr(value)
        return Reading(shown, self.unit, self.limit, Symptom.VALUE if bad else None)


class ReadingObserver(JudgedReadings, ABC):
    """Judges each reading by itself. Subclasses write `judge`."""

    @abstractmethod
    def judge(self, value: Any) -> bool | None:
        """Return whether a reading is good; None: it says nothing."""

    def feed(self, source: str, time_ns: int, value: object) -> None:
        if type(value) is float:
            number(value)  # one that is none is nothing to judge
        good = self.judge(value)
        if good is not None:
            self._judgement.add(time_ns, bool(good), read=value)


class FunctionObserver(ReadingObserver):
    """Judges by a function of the value."""

    def __init__(
        self, function: Callable[..., bool | None], atom: str, source: str, readings: Readings | None = None
    ) -> None:
        super().__init__(atom, source, readings)
        self._function = function

    def judge(self, value: object) -> bool | None:
        return self._function(value)
