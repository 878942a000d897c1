"""One explanation for a whole log, or for each window of it: the faults that explain all that was seen there.

    states of a window ──► what each rests on ──► distinct ones ──► SnapshotEngine ──► one row

What is broken is taken to be broken all the while, and what was seen of it may come and go: a fault that
shows in one state is none the less a fault in the others. So a window in which one thing failed after
another has both in its diagnoses.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robomend_batch.answers import NOTHING, Told, distinct
from robomend_batch.parts import Parts
from robomend_batch.track import Times

MOST_WAITING = 10_000
"""Rows that are written together."""

Row = tuple[int, ...]
"""What a state rests on, as a code without its trailing zeros."""


class Windows(Parts):
    """Takes the stretches of one log, and writes a row for each window of each segment."""

    window_ns: int | None = None
    """None: a segment is one window."""

    def __init__(self, *given: Any, window_ns: int | None) -> None:
        super().__init__(*given)
        self.window_ns = window_ns
        self._segment_start: tuple[int, int] | None = None  # segment, its beginning
        self._here: tuple[int, int] | None = None  # segment, number of the window
        self._start_ns = self._end_ns = 0
        self._rows: dict[Row, None] = {}
        self._of_functions: dict[Row, None] = {}
        self._heard = False
        self._done: list[tuple[int, int, int, Told, list[str]]] = []

    def finish(self) -> None:
        super().finish()
        self._end_window()
        self._write_done()

    def _flush(self, last: bool) -> None:
        if not self._waiting:
            return
        sensors = self._sensors()
        segment, start, end, codes = self._taken(sensors)
        states, state_of = distinct(codes)
        grounds, heard = self._answers.library(sensors).grounds(states), self._answers.heard(states, sensors)
        rows = [_row(one) for one in grounds.tolist()]
        of_functions = [_row(one) for one in self._answers.of_functions(states, sensors).tolist()]
        pieces = zip(segment.tolist(), start.tolist(), end.tolist(), state_of.tolist(), strict=True)
        for number, start_ns, end_ns, state in pieces:
            self._piece(number, start_ns, end_ns, rows[state], of_functions[state], bool(heard[state]))

    def _piece(
        self, segment: int, start_ns: int, end_ns: int, row: Row, of_functions: Row, heard: bool
    ) -> None:
        """A state that held for a while, in one window or several."""
        if self._segment_start is None or self._segment_start[0] != segment:
            self._end_window()
            self._segment_start = segment, start_ns
        origin_ns, window_ns = self._segment_start[1], self.window_ns
        first = 0 if window_ns is None else (start_ns - origin_ns) // window_ns
        last = 0 if window_ns is None else max(first, (end_ns - 1 - origin_ns) // window_ns)
        for window in range(first, last + 1):
            if self._here != (segment, window):
                self._end_window()
                self._here = segment, window
                self._start_ns = start_ns if window_ns is None else origin_ns + window * window_ns
            self._end_ns = end_ns if window_ns is None else min(end_ns, origin_ns + (window + 1) * window_ns)
            self._heard |= heard
            if heard:
                self._rows[row] = None
                self._of_functions[of_functions] = None

    def _end_window(self) -> None:
        if self._here is None:
            return
        told = NOTHING
        literals: list[str] = []
        if self._heard:
            told, literals = self._answers.together(
                frozenset(self._rows), self._sensors(), self._of_functions
            )
        self._done.append((self._here[0], self._start_ns, self._end_ns, told, literals))
        self._here, self._rows, self._of_functions, self._heard = None, {}, {}, False
        if len(self._done) >= MOST_WAITING:
            self._write_done()

    def _write_done(self) -> None:
        if not self._done:
            return
        segment, start, end, told, grounds = zip(*self._done, strict=True)
        self._done = []
        number: dict[Told, int] = {}
        numbers = [number.setdefault(one, len(number)) for one in told]
        self._told(
            np.array(segment, dtype=np.int32),
            _times(start),
            _times(end),
            [*number],
            np.array(numbers, dtype=np.intp),
            list(grounds),
            np.arange(len(grounds)),
        )


def _times(values: tuple[int, ...]) -> Times:
    return np.array(values, dtype=np.int64)


def _row(words: list[int]) -> Row:
    while words and not words[-1]:
        words = words[:-1]
    return tuple(words)
