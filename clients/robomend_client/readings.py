"""What was measured, beside the literal that it became: "16 of 50 Hz", "exit code 1: cannot open /dev/lidar".

A reading goes with its literal from the observer to the page; no rule reads it. Its `symptom` says in which
way something is bad, and by that chooses which remedies make sense: what is too fast needs no power cycle.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

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

    def __str__(self) -> str:
        """Return it as a person reads it: "19.1 V, at least 22"."""
        shown = self.value if isinstance(self.value, str) else f"{self.value:.4g}"
        measured = f"{shown} {self.unit}" if self.unit else shown
        return f"{measured}, {self.limit}" if self.limit else measured
