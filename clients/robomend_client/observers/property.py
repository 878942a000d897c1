"""The property observer (PObs): ok(p) while a number is where it should be: CPU, memory, temperature,
current.

    high ───────────────────────── bad above
         ┄┄┄┄┄┄ hysteresis ┄┄┄┄┄┄┄ good again below
         ┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄┄ good again above
    low  ───────────────────────── bad below

The readings go through a filter first, then `agreeing` and `debounce_s` decide when a verdict turns. What
is not a number (NaN, infinite) is no reading. When no reading comes for `lifetime_s`, the property is
unknown.

Source: the paper, section IV-B. The published observer tested `v ≥ th − dev or v ≤ th + dev`, which always
holds; `preset: published` has the band that was meant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from robomend_client.observers.base import number
from robomend_client.observers.filters import Filter
from robomend_client.observers.reading import JudgedReadings, Readings

UNITS = {
    "board:voltage": "V",
    "board:current": "A",
    "host:Wait": "of the time some process waits for a processor",
}


@dataclass(frozen=True)
class Band:
    """Where the number should be; one of the limits may be absent.

    Attributes:
        low: below it the number is bad, in the units of the source.
        high: above it the number is bad, in the units of the source.
        hysteresis: how far inside the limits it must be to be good again, in the units of the source.
        unit: of the source, for people: V, °C.
    """

    low: float | None = None
    high: float | None = None
    hysteresis: float = 0.0
    unit: str = ""

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"published": {"low": 0.1, "high": 0.3}}

    def __post_init__(self) -> None:
        if self.low is None and self.high is None:
            raise ValueError("low or high is needed: what is the number measured against?")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"low must not be above high, {self.high:g}")
        if self.hysteresis < 0:
            raise ValueError(f"hysteresis must not be below 0, but is {self.hysteresis:g}")
        if self.low is not None and self.high is not None and 2 * self.hysteresis > self.high - self.low:
            raise ValueError("hysteresis leaves nothing of the band: it must be at most half as wide")

    def __str__(self) -> str:
        if self.low is None:
            return f"at most {self.high:g}"
        return f"at least {self.low:g}" if self.high is None else f"{self.low:g} to {self.high:g}"

    def holds(self, value: float, was_good: bool) -> bool:
        """Return whether a value is good, coming from good or bad."""
        inside = 0.0 if was_good else self.hysteresis
        return (self.low is None or value >= self.low + inside) and (
            self.high is None or value <= self.high - inside
        )


class PropertyObserver(JudgedReadings):
    """Watches one number."""

    def __init__(
        self,
        atom: str,
        source: str,
        band: Band,
        readings: Readings | None = None,
        smoothing: Filter | None = None,
    ) -> None:
        super().__init__(atom, source, readings)
        smoothing = smoothing or Filter()
        self._band = band
        self._filter = smoothing.make()
        self._good = True
        # Of readings that are not smoothed, so many say all that is known; 0: each one counts.
        self._remembered = (readings or Readings()).agreeing if smoothing == Filter() else 0
        interval_s = (readings or Readings()).interval_s
        self.detection_s += (smoothing.samples - 1) * interval_s
        self.settling_s = self.detection_s
        self.limit = str(band)
        self.unit = band.unit or next((u for begin, u in UNITS.items() if source.startswith(begin)), "")

    def reset(self, time_ns: int) -> None:
        """What lies between bad and good again is what it was, also after a reset."""
        super().reset(time_ns)
        if not self.latched:
            self._filter.reset()

    def steady(self, times_ns: Any, values: Any, until_ns: int) -> Callable[[], None] | None:
        """See Steady: each reading by itself is good, and the last ones say all that is remembered."""
        band, readings = self._band, self._remembered
        if not readings or not self._good or not self._judgement.goes_on(times_ns, until_ns):
            return None
        low, high = values.min(), values.max()  # not a number, if one of them is none
        if not (low - low == 0 and high - high == 0 and band.holds(low, True) and band.holds(high, True)):
            return None

        def take() -> None:
            for time_ns, value in zip(
                times_ns[-readings:].tolist(), values[-readings:].tolist(), strict=True
            ):
                self.feed(next(iter(self.sources)), time_ns, value)

        return take

    def feed(self, source: str, time_ns: int, value: object) -> None:
        smooth = self._filter.add(time_ns, number(value))
        self._good = self._band.holds(smooth, self._good)
        self._judgement.add(time_ns, self._good, self._filter.since_ns, smooth)
