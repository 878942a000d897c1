"""What the general observer expects of a topic: its rate, its silence, and what may be lost or held up.

Source: the paper, section IV-B; rate, tolerance, window and silence as published by `preset: published` (the
paper's ω is a time window, the published observer's a number of messages).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import Any, ClassVar

from robomend_client.observers.base import positive

LEAST_SILENCE_S = 0.35
"""Whatever the rate, for a busy computer is late by a tenth of a second or two."""

TESTS = ("tolerance", "student_t")


@dataclass(frozen=True)
class Rate:
    """What is expected of a topic. A parameter that is None follows from the others.

    Attributes:
        rate_hz: the rate that is expected, in messages per second.
        tolerance_hz: ok while the rate of the window differs by less, in messages per second.
        window: the rate is that of so many messages; by default so many, 10 at least, that `lost` lost ones
            stay within the tolerance.
        silence_s: so many seconds without a message are not ok; by default half an interval more than `lost`
            intervals, 0.35 s at least.
        first_s: until its very first message, silence counts after so many seconds; by default silence_s, and
            under `topics:` 2.
        check_s: how often a verdict on the rate is given, in seconds.
        settle: intervals between messages that a verdict needs.
        test: `tolerance`, or `student_t`: a wrong rate must be significant as well.
        significance: the level of the t test, two-sided: a probability.
        tolerance_above_hz: how much faster it may be, in messages per second; by default tolerance_hz.
        pause_s: an interval counts in the rate as so many seconds at most; by default as it is.
        lost: messages that may be lost in a window; missing in a row they are silence.
        held_s: messages may be held up for so many seconds, and then come at once; by default as long as
            silence.
    """

    rate_hz: float = 10.0
    tolerance_hz: float = 1.0
    window: int | None = None
    silence_s: float | None = None
    first_s: float | None = None
    check_s: float = 0.05
    settle: int | None = 5  # None: a full window
    test: str = "tolerance"
    significance: float = 0.05
    tolerance_above_hz: float | None = None
    pause_s: float | None = None
    lost: int = 3
    held_s: float | None = None

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "published": {"window": 10, "silence_s": 2.0, "check_s": 0.5, "settle": None, "held_s": 0.0}
    }

    def __post_init__(self) -> None:
        positive(rate_hz=self.rate_hz, tolerance_hz=self.tolerance_hz, check_s=self.check_s)
        if self.tolerance_above_hz is not None:
            positive(tolerance_above_hz=self.tolerance_above_hz)
        if self.window is not None and not 2 <= self.window <= 10_000:
            raise ValueError(
                f"window must be from 2 to 10000 messages, not {self.window}: a rate needs an interval"
            )
        if not 1 <= self.lost <= 1000:
            raise ValueError(f"lost must be from 1 to 1000 messages, not {self.lost}")
        if self.settle is not None and (self.settle < 1 or (self.window and self.settle >= self.window)):
            most = f"window − 1 = {self.window - 1}" if self.window else "window − 1"
            raise ValueError(f"settle must be from 1 to {most}, not {self.settle}")
        if self.silence_s is not None:
            positive(silence_s=self.silence_s)
            if self.silence_s * self.rate_hz <= 1:
                raise ValueError(
                    f"silence_s of {self.silence_s:g} is no longer than one interval at {self.rate_hz:g} Hz: "
                    "every message would come too late"
                )
        if self.pause_s is not None and not self.pause_s * self.rate_hz > 1:
            raise ValueError(
                f"pause_s of {self.pause_s:g} is no longer than one interval at {self.rate_hz:g} Hz: "
                "no rate could be too slow"
            )
        if self.first_s is not None and not 0 <= self.first_s <= 86400:
            raise ValueError(f"first_s must be from 0 to 86400, not {self.first_s:g}")
        if self.held_s is not None and not 0 <= self.held_s <= 86400:
            raise ValueError(f"held_s must be from 0 to 86400, not {self.held_s:g}")
        if self.test not in TESTS:
            raise ValueError(f"test must be one of {', '.join(TESTS)}, not {self.test!r}")
        if not 0 < self.significance < 1:
            raise ValueError(f"significance must be above 0 and below 1, not {self.significance:g}")

    @classmethod
    def published(cls, rate_hz: float = 10.0, tolerance_hz: float = 1.0) -> Rate:
        """Return the released system's parameters."""
        return cls(rate_hz, tolerance_hz, **cls.PRESETS["published"])

    @property
    def lowest_hz(self) -> float:
        """A rate must be above it."""
        return self.rate_hz - self.tolerance_hz

    @property
    def highest_hz(self) -> float:
        """And below this."""
        above_hz = self.tolerance_above_hz
        return self.rate_hz + (self.tolerance_hz if above_hz is None else above_hz)

    def __str__(self) -> str:
        if self.tolerance_above_hz in (None, self.tolerance_hz):
            return f"{self.rate_hz:g} ± {self.tolerance_hz:g}"
        return f"{self.rate_hz:.4g} ({self.lowest_hz:.4g} to {self.highest_hz:.4g})"

    @property
    def messages(self) -> int:
        """The size of the window: of n intervals k lost ones take k of n + k, and some of it is for
        jitter.
        """
        if self.window is not None:
            return self.window
        enough = ceil(self.lost * self.rate_hz / (0.85 * self.tolerance_hz)) - self.lost + 1
        return max(10, (self.settle or 0) + 1, min(enough, 10_000))

    @property
    def intervals(self) -> int:
        """How many a verdict needs."""
        return self.messages - 1 if self.settle is None else self.settle

    @property
    def silence(self) -> float:
        """Seconds without a message that are not ok."""
        if self.silence_s is not None:
            return self.silence_s
        return max(LEAST_SILENCE_S, (self.lost + 0.5) / self.rate_hz)

    @property
    def first_verdict_s(self) -> float:
        """From the beginning to a verdict of either sign, at most: a rate that is a little too slow needs
        nearly a whole window until it cannot be that `lost` messages were lost.
        """
        slowest_s = (self.intervals + 1) * self.silence  # each interval just not a silence
        intervals = self.messages - 1
        if self.lowest_hz * self.silence <= 1:
            return slowest_s  # what is too slow is a silence
        doubt = 1 + self.lost / max(1, intervals - 1)
        return max(slowest_s, (intervals + 1) / self.lowest_hz * doubt)

    @property
    def held(self) -> int:
        """How many messages can have been held up, and come at once."""
        held_s = self.silence if self.held_s is None else self.held_s
        return min(ceil(held_s * self.rate_hz), 1000)
