"""A computer's clock that is wrong, for whoever is started with its environment.

A program in Python is told the time by a `sitecustomize` of ours, others by libfaketime.
With that each wait of a thread reads the file, which can take a program in Python with several threads all
of a processor. Clocks that only go on (CLOCK_MONOTONIC) are right, as they are on such a computer.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import pytest
from tests.packages import FAKETIME, FAKETIME_LIBRARY

_why_not = lru_cache(maxsize=1)(FAKETIME.install)  # it is tried once

WRONG = """
import os, time

right_ns, file = time.time_ns, {file!r}

def time_ns():
    with open(file) as said:
        return right_ns() + int(float(said.read()) * 1e9)

time.time_ns, time.time = time_ns, lambda: time_ns() / 1e9
"""


class WrongClock:
    """The clock; it may be set while others live by it."""

    def __init__(self, folder: Path, ahead_s: float = 0.0) -> None:
        self._file = folder / "clock"
        self.set(ahead_s)

    def set(self, ahead_s: float) -> None:
        """Have it so far ahead of the right time, or behind it if that is negative."""
        beside = self._file.with_suffix(".new")
        beside.write_text(f"{ahead_s:+g}\n")
        beside.rename(self._file)

    @property
    def environment(self) -> Mapping[str, str]:
        """Of programs in Python that live by it."""
        folder = self._file.parent / "wrong"
        folder.mkdir(exist_ok=True)
        (folder / "sitecustomize.py").write_text(WRONG.format(file=str(self._file)))
        path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
        return {**os.environ, "PYTHONPATH": path}

    @property
    def native(self) -> Mapping[str, str]:
        """Of other programs; skips the test where libfaketime cannot be had, in CI it fails."""
        if why := _why_not():
            (pytest.fail if os.environ.get("CI") else pytest.skip)(why)
        return {
            **os.environ,
            "LD_PRELOAD": str(FAKETIME_LIBRARY),
            "FAKETIME_TIMESTAMP_FILE": str(self._file),
            "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "DONT_FAKE_MONOTONIC": "1",
            "NO_FAKE_STAT": "1",
        }
