"""What was measured, beside the literal that it became: "16 of 50 Hz", "exit code 1: cannot open /dev/lidar".

A reading goes with its literal from the observer to the page; no rule reads it. Its `symptom` says in which
way something is bad, and by that chooses which remedies make sense: what is too fast needs no power cycle.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from math import isfinite
from typing import Any, NamedTuple

MAX_TEXT = 500
"""Characters of a reading's text, and of its limit."""


class Symptom(str, enum.Enum):  # StrEnum is not in Python 3.10
    """The kind of a bad verdict; a good one has none."""

    __str__ = str.__str__

    SILENT = "silent"  # nothing comes
    SLOW = "slow"  # it comes, below its rate
    FAST = "fast"  # it comes, above its rate
    STILL = "still"  # it comes at its rate, with a value that does not change
    OLD = "old"  # it comes, with stamps behind the clock
    PUBLISHERS = "publishers"  # more publish it than should
    SELF_REPORT = "self-report"  # the component itself says so (diagnostics), whatever its data are
    VALUE = "value"  # a value outside its band, two that do not match, a wrong trend
    ENDED = "ended"  # the process is not there
    HALTED = "halted"  # the process is there, and does not run (stopped, hung in the kernel)


class Reading(NamedTuple):
    """A measured value or a text, with its unit and the limit that it is held against, in words."""

    value: float | str
    unit: str = ""
    limit: str = ""  # "at least 22", "50 ± 5"
    symptom: Symptom | None = None

    def as_json(self) -> dict[str, Any]:
        """Return it as it goes over the wire and is kept, without what it does not say.

        A text is cut to MAX_TEXT, and what does not print (colours of a terminal, line breaks) becomes a
        space: the service refuses it otherwise, and what a program has printed last may be anything.
        """
        value = self.value
        if not isinstance(value, str) and not isfinite(value):
            value = str(value)  # JSON has no such number
        found: dict[str, Any] = {"value": _printable(value) if isinstance(value, str) else value}
        if self.unit:
            found["unit"] = _printable(self.unit)
        if self.limit:
            found["limit"] = _printable(self.limit)
        if self.symptom is not None:
            found["symptom"] = str(self.symptom)
        return found

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Reading:
        """Return the reading of `as_json`."""
        symptom = value.get("symptom")
        return cls(
            value["value"],
            value.get("unit") or "",
            value.get("limit") or "",
            None if symptom is None else Symptom(symptom),
        )

    @property
    def number(self) -> float | None:
        """What was measured as a number; None: it is none."""
        try:
            found = float(self.value)
        except ValueError:
            return None
        return found if isfinite(found) else None

    def __str__(self) -> str:
        """Return it as a person reads it: "19.1 V, at least 22"."""
        if isinstance(self.value, str):
            shown = self.value
        else:  # four digits, and never 1.08e+04 for 10800
            shown = f"{self.value:.0f}" if 1e4 <= abs(self.value) < 1e15 else f"{self.value:.4g}"
        measured = f"{shown} {self.unit}" if self.unit else shown
        return f"{measured}, {self.limit}" if self.limit else measured


def _printable(text: str) -> str:
    if not text.isprintable():
        text = "".join(letter if letter.isprintable() else " " for letter in text).strip()
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 1] + "…"
