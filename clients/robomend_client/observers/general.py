"""The general observer (GObs): ok(t) while the messages of topic t come at their rate.

Only the times of messages count, so any topic can be watched without touching the nodes that use it.

    messages   |    |    |    |    |              |    |    |    |    |
    verdict    unknown ·· ok ········ not ok ······· (settling) ···· ok
                                     └ silence_s without one ┘

The rate f of the newest messages is (intervals) / (their span); ok(t) iff |f − rate| < tolerance. A verdict
needs `settle` intervals. Silence of `silence_s` is not ok at once, and what came before it no longer counts.
Until the first verdict the topic is unknown: missing data is no literal.

Source: the paper, section IV-B; parameters and their defaults as published (the paper's ω is a time window,
the published observer's a number of messages).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from robomend_client.literals import Literal, fails, holds
from robomend_client.observers.base import SECOND, ns


@dataclass(frozen=True, slots=True)
class Rate:
    """What is expected of a topic; the defaults are the published ones."""

    rate_hz: float = 10.0
    tolerance_hz: float = 1.0
    window: int = 10  # messages that the rate is measured over
    silence_s: float = 2.0
    check_s: float = 0.5
    settle: int | None = None  # intervals that a verdict needs; None: a full window

    def __post_init__(self) -> None:
        for name in ("rate_hz", "tolerance_hz", "silence_s", "check_s"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, not {getattr(self, name)}")
        if self.window < 2:
            raise ValueError(
                f"window must be 2 messages or more, not {self.window}: a rate needs an interval"
            )
        if self.settle is not None and not 1 <= self.settle < self.window:
            raise ValueError(f"settle must be from 1 to window − 1 = {self.window - 1}, not {self.settle}")
        if self.silence_s * self.rate_hz <= 1:
            raise ValueError(
                f"silence_s of {self.silence_s} is no longer than one interval at {self.rate_hz} Hz: "
                "every message would come too late"
            )

    @property
    def intervals(self) -> int:
        return self.window - 1 if self.settle is None else self.settle


class GeneralObserver:
    """Watches the rate of one topic."""

    def __init__(self, topic: str, expected: Rate | None = None, *, start_ns: int) -> None:
        self.topic = topic
        self.expected = expected or Rate()
        self._silence_ns = ns(self.expected.silence_s)
        self._times: deque[int] = deque(maxlen=self.expected.window)
        self._intervals = 0  # since the last silence; the window may have forgotten the first ones
        self._newest_ns = start_ns
        self._was_silent = False

    @property
    def sources(self) -> frozenset[str]:
        return frozenset((self.topic,))

    @property
    def period_ns(self) -> int:
        return ns(self.expected.check_s)

    def feed(self, source: str, time_ns: int, value: object = None) -> None:
        """A message of the topic arrived at `time_ns`; its value does not matter."""
        time_ns = max(time_ns, self._newest_ns)
        if time_ns - self._newest_ns >= self._silence_ns:
            self._was_silent = True
            self._times.clear()
            self._intervals = 0
        elif self._times:
            self._intervals += 1
        self._times.append(time_ns)
        self._newest_ns = time_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        ok = self._verdict(now_ns)
        if ok is None:
            return ()
        return (holds("ok", self.topic) if ok else fails("ok", self.topic),)

    def rate_hz(self) -> float | None:
        """Return the measured rate, or None while there is none to speak of."""
        if self._intervals < self.expected.intervals:
            return None
        span_ns = self._times[-1] - self._times[0]
        return (len(self._times) - 1) * SECOND / span_ns if span_ns else float("inf")

    def _verdict(self, now_ns: int) -> bool | None:
        if now_ns - self._newest_ns >= self._silence_ns:
            return False
        rate_hz = self.rate_hz()
        if rate_hz is None:
            return False if self._was_silent else None
        return abs(rate_hz - self.expected.rate_hz) < self.expected.tolerance_hz
