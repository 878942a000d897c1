"""How far a run is, on stderr: a line that is written over on a terminal, else one now and then."""

from __future__ import annotations

import sys
from time import monotonic
from typing import TextIO

from robomend_client.counts import counted

TERMINAL_S, FILE_S = 0.2, 10.0


class Progress:
    """Counts bytes, as logs differ in size."""

    def __init__(self, logs: int, size: int, *, quiet: bool = False, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._terminal = self._stream.isatty()
        self._logs, self._size = logs, size
        self._done = self._bytes = 0
        self._open: dict[str, float] = {}  # log in hand -> bytes that are read
        self._began_s = self._told_s = monotonic()
        self._wide = 0

    def reading(self, name: str, share: float, size: int) -> None:
        """Of a log in hand so much is read, from 0 to 1."""
        self._open[name] = min(max(share, 0.0), 1.0) * size
        self._now_and_then()

    def finished(self, name: str, size: int) -> None:
        """A log is done."""
        self._done += 1
        self._bytes += size
        self._open.pop(name, None)
        self._now_and_then()

    def _now_and_then(self) -> None:
        now_s = monotonic()
        if now_s - self._told_s >= (TERMINAL_S if self._terminal else FILE_S):
            self._told_s = now_s
            self._tell(now_s)

    def say(self, text: str) -> None:
        """Write a line that stays."""
        self._wipe()
        print(text, file=self._stream, flush=True)

    def close(self) -> None:
        """Leave nothing behind on a terminal."""
        self._wipe()

    def _tell(self, now_s: float) -> None:
        if self._quiet:
            return
        spent_s = now_s - self._began_s
        read = self._bytes + sum(self._open.values())
        rate = read / spent_s if spent_s else 0.0
        left = f", {_clock((self._size - read) / rate)} left" if rate else ""
        megabytes = f"{read / 1e6:,.0f} of {self._size / 1e6:,.0f} MB, {rate / 1e6:,.1f} MB/s"
        text = f"{self._done} of {counted(self._logs, 'log')}, {megabytes}{left}"
        if self._terminal:
            self._wipe()
            self._wide = len(text)
            print(text, end="\r", file=self._stream, flush=True)
        else:
            print(text, file=self._stream, flush=True)

    def _wipe(self) -> None:
        if self._wide:
            print(" " * self._wide, end="\r", file=self._stream, flush=True)
            self._wide = 0


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    return f"{minutes}:{rest:02}"
