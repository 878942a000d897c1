"""Incidents: single bad events (an aborted goal, a line of ERROR, a restart), which hold for a while.

    events       x        x x
    verdict   ok ── not ok ──────────── ok       good again once none came for `hold_s`, or something good did
                          └─ hold_s ─┘

Silence is good news of this kind: nobody says that nothing was aborted. So it counts only once it was looked
for `hold_s`, after the beginning and after a reset as well.
"""

from __future__ import annotations

from collections import deque

from robomend_client.literals import Literal, parse_atom
from robomend_client.observers.base import NOTHING, SECOND, Evidence, ns, positive
from robomend_client.readings import Reading

MOST = 1000
"""Incidents in a row, and within a while, at most."""


def check_incidents(hold_s: float, least: int, name: str) -> None:
    """Check parameters; the error begins with the name of the wrong one."""
    positive(hold_s=hold_s)
    if hold_s > 86400:
        raise ValueError(f"hold_s must be at most 86400, not {hold_s:g}")
    if not 1 <= least <= MOST:
        raise ValueError(f"{name} must be from 1 to {MOST}, not {least}")


class Incidents:
    """The verdict on one atom, by what was noted of it; subclasses read samples and say what was seen."""

    period_ns = 0
    detection_s = 1.0
    bears_lapses = True
    """What has happened is not undone by a while in which nobody looked, up to half of `hold_s`."""

    def __init__(self, atom: str, least: int, hold_s: float) -> None:
        """`least` incidents within `hold_s`, and nothing good between them, are bad."""
        self.atoms = (parse_atom(atom),)
        self.settling_s = hold_s
        self.hold_s = hold_s
        self._hold_ns = ns(hold_s)
        self._signs = {good: (Literal(self.atoms[0], good),) for good in (True, False)}
        self._noted: deque[int] = deque(maxlen=least)
        self._began_ns = 0
        self._forget(0)

    def reset(self, time_ns: int) -> None:
        self._forget(time_ns)

    def _forget(self, time_ns: int) -> None:
        self._noted.clear()
        self._began_ns = time_ns
        self._bad = False
        self._good_ns: int | None = None  # the newest good event
        self.count = 0  # incidents since the last good event

    def incident(self, time_ns: int) -> None:
        """Note a bad event."""
        self._lapse(time_ns)
        self.count = min(self.count + 1, 10**9)
        self._noted.append(time_ns)
        full = len(self._noted) == self._noted.maxlen
        if full and time_ns - self._noted[0] < self._hold_ns:
            self._bad = True

    def well(self, time_ns: int) -> None:
        """Note a good event: what was bad is over."""
        self._noted.clear()
        self._bad = False
        self.count = 0
        self._good_ns = time_ns

    def due_ns(self) -> int | None:
        """Return when silence is good news."""
        return (self._noted[-1] if self._noted else self._began_ns) + self._hold_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        self._lapse(now_ns)
        if self._bad:
            return self._signs[False]
        looked = now_ns - self._began_ns >= self._hold_ns
        return self._signs[True] if looked or self._good_ns is not None else NOTHING

    def _lapse(self, now_ns: int) -> None:
        if self._noted and now_ns - self._noted[-1] >= self._hold_ns:
            self._noted.clear()
            self._bad = False
            self.count = 0

    def evidence_of(self, now_ns: int, reading: Reading) -> Evidence:
        """Return what the verdict rests on: the newest incident, the newest good event, or silence."""
        if self._bad:
            return Evidence(self._noted[-1], self._good_ns, reading)
        silent_ns = max(self._began_ns, now_ns - self._hold_ns)
        return Evidence(max(silent_ns, self._good_ns or 0), None, reading)


def for_s(nanoseconds: int) -> str:
    """Return a span as people say it: 2.1 s, 3 min, 4 h, 2 days."""
    seconds = nanoseconds / SECOND
    for size, name in ((86400, "days"), (3600, "h"), (60, "min")):
        if round(seconds / size) > 1:
            return f"{seconds / size:.0f} {name}"
    return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
