"""OBS ⊕ over a whole log: from rows that each set a sensor to the codes that held, and from when on.

The rules are those of robomend.observations.obs, and a property test holds the two together:

- a row replaces what its sensor showed; one that is older than what it would replace changes nothing;
- what has a lifetime is unknown when that is over;
- rows with equal times count together: what holds is what the last of them leaves.

Here they are applied to many rows at once. A code is bits (robomend.diagnosis.library), so each row flips
some of them, and the codes are a running XOR of the flips:

    rows, by time           scan true    map false   scan false  …
    bits of that sensor     00 → 01      00 → 10     01 → 10
    flips                   01 << 2s     10 << 2m    11 << 2s
    codes                   └────────── running XOR ──────────►

Time that goes back by more than JUMP_NS begins a new segment: nothing is known there but what comes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robomend.diagnosis.library import SENSORS_A_WORD, Codes
from robomend.observations.obs import FOREVER
from robomend_batch.problems import LogRefused
from robomend_client.observers.driver import JUMP_NS

Times = NDArray[np.int64]

MOST_SEGMENTS = 1000

STATES = np.array([2, 1, 0], dtype=np.uint64)
"""FALSE, TRUE, UNKNOWN (by index -1) -> the two bits of a sensor."""


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows in the order of arrival; one that sets several sensors is several."""

    time_ns: Times
    sensor: NDArray[np.int32]
    value: NDArray[np.int8]  # TRUE, FALSE or UNKNOWN of robomend_batch.words
    expires_ns: Times  # FOREVER: it has no lifetime

    def __len__(self) -> int:
        return len(self.time_ns)

    def part(self, start: int, end: int) -> Rows:
        """Return some of them."""
        return Rows(
            self.time_ns[start:end], self.sensor[start:end], self.value[start:end], self.expires_ns[start:end]
        )


@dataclass(frozen=True, slots=True)
class Stretch:
    """Codes of one segment, each from its time on until the next."""

    segment: int
    time_ns: Times
    codes: Codes
    end_ns: int  # of what is known of the segment so far


class Track:
    """What the sensors of one log show; see the module."""

    def __init__(self) -> None:
        self.segment = 0
        self._now_ns: int | None = None  # the newest time of the segment
        self._code = np.zeros(1, dtype=np.uint64)
        self._time = np.zeros(0, dtype=np.int64)  # of each sensor: when it was set, …
        self._expires = np.zeros(0, dtype=np.int64)  # … and until when that counts

    def restart(self, time_ns: int) -> None:
        """Begin a segment."""
        self.segment += self._now_ns is not None
        self._now_ns = time_ns
        self._code = np.zeros(1, dtype=np.uint64)
        self._time = np.zeros(0, dtype=np.int64)
        self._expires = np.zeros(0, dtype=np.int64)

    def begun(self, time_ns: int) -> Stretch:
        """Begin a segment in which nothing is known yet, and that is to be told."""
        self.restart(time_ns)
        return Stretch(self.segment, np.array([time_ns], dtype=np.int64), self._code.reshape(1, 1), time_ns)

    def add(self, rows: Rows) -> Iterator[Stretch]:
        """Take in rows; yield what held up to the newest of them."""
        if not len(rows):
            return
        start = 0
        for cut in self._jumps(rows.time_ns):
            yield from self._segment_part(rows.part(start, cut))
            self.restart(int(rows.time_ns[cut]))
            start = cut
        yield from self._segment_part(rows.part(start, len(rows)))

    def show(self, time_ns: Times, codes: Codes) -> Iterator[Stretch]:
        """Take in rows that each say all that was known at their time; yield what held."""
        start = 0
        for cut in [*self._jumps(time_ns), len(time_ns)]:
            if cut > start:
                yield self._shown(time_ns[start:cut], codes[start:cut])
            if cut < len(time_ns):
                self.restart(int(time_ns[cut]))
            start = cut

    def _shown(self, time_ns: Times, codes: Codes) -> Stretch:
        if self._now_ns is None:
            self._now_ns = int(time_ns[0])
        if time_ns[0] < self._now_ns or not (time_ns[1:] > time_ns[:-1]).all():
            newest = np.maximum(np.maximum.accumulate(time_ns), self._now_ns)
            places = np.flatnonzero(time_ns == newest)  # what is older changes nothing
            time_ns, codes = time_ns[places], codes[places]
            last = np.ones(len(time_ns), dtype=np.bool_)
            last[:-1] = time_ns[1:] != time_ns[:-1]
            time_ns, codes = time_ns[last], codes[last]
            self._now_ns = int(newest[-1])
        else:
            self._now_ns = int(time_ns[-1])
        changed = _changes(codes)
        return Stretch(self.segment, time_ns[changed], codes[changed], self._now_ns)

    def advance(self, time_ns: int) -> Iterator[Stretch]:
        """Let time pass: lifetimes run out."""
        none = np.zeros(0, dtype=np.int64)
        rows = Rows(none, none.astype(np.int32), none.astype(np.int8), none)
        if self._now_ns is not None and time_ns > self._now_ns:
            yield self._taken(rows, none, time_ns)

    def _jumps(self, time_ns: Times) -> list[int]:
        """Return the places of the rows that begin a segment."""
        cuts: list[int] = []
        floor = self._now_ns
        if (floor is None or time_ns[0] >= floor) and not (time_ns[1:] < time_ns[:-1]).any():
            return cuts
        start = 0
        while True:
            newest = np.maximum.accumulate(time_ns[start:])
            if floor is not None:
                newest = np.maximum(newest, floor)
            back = np.flatnonzero(time_ns[start:] < newest - JUMP_NS)
            if not len(back):
                return cuts
            start += int(back[0])
            cuts.append(start)
            if self.segment + len(cuts) >= MOST_SEGMENTS:
                raise LogRefused(f"time goes back {MOST_SEGMENTS} times: sort it", "")
            floor = int(time_ns[start])

    def _segment_part(self, rows: Rows) -> Iterator[Stretch]:
        if not len(rows):
            return
        if self._now_ns is None:
            self._now_ns = int(rows.time_ns[0])
        self._room(int(rows.sensor.max()) + 1)
        rows = self._in_time(rows)
        at_ns = np.maximum(np.maximum.accumulate(rows.time_ns), self._now_ns) if len(rows) else rows.time_ns
        yield self._taken(rows, at_ns, int(at_ns[-1]) if len(rows) else self._now_ns)

    def _room(self, sensors: int) -> None:
        """Make room for so many sensors; a new one was never set."""
        new = sensors - len(self._time)
        if new > 0:
            self._time = np.concatenate([self._time, np.full(new, -FOREVER, dtype=np.int64)])
            self._expires = np.concatenate([self._expires, np.full(new, FOREVER, dtype=np.int64)])
        words = -(-len(self._time) // SENSORS_A_WORD)
        if words > len(self._code):
            more = np.zeros(words - len(self._code), dtype=np.uint64)
            self._code = np.concatenate([self._code, more])

    def _in_time(self, rows: Rows) -> Rows:
        """Return the rows without those that are older than what they would replace."""
        time_ns = rows.time_ns
        assert self._now_ns is not None
        if time_ns[0] >= self._now_ns and not (time_ns[1:] < time_ns[:-1]).any():
            return rows
        newest = self._time.copy()
        kept = np.ones(len(rows), dtype=np.bool_)
        for place, (time, sensor) in enumerate(zip(time_ns.tolist(), rows.sensor.tolist(), strict=True)):
            if time < newest[sensor]:
                kept[place] = False
            else:
                newest[sensor] = time
        return Rows(time_ns[kept], rows.sensor[kept], rows.value[kept], rows.expires_ns[kept])

    def _taken(self, rows: Rows, at_ns: Times, end_ns: int) -> Stretch:
        """Take in rows that all count, at these times, and let time pass until the end."""
        began_ns = self._now_ns
        assert began_ns is not None
        sensor, bits = rows.sensor, STATES[rows.value]
        bits = np.where(rows.expires_ns <= at_ns, np.uint64(0), bits)
        expires, expired = self._expiries(rows, at_ns, end_ns)
        time_ns = np.concatenate([expires, at_ns])
        sensor = np.concatenate([expired, sensor])
        bits = np.concatenate([np.zeros(len(expires), dtype=np.uint64), bits])
        if len(expires):  # stable: what expires comes before what is set at the same time
            order = np.argsort(time_ns, kind="stable")
            time_ns, sensor, bits = time_ns[order], sensor[order], bits[order]
        codes = self._codes(sensor, bits)
        self._remember(rows)
        self._now_ns = max(began_ns, end_ns)
        self._expires[self._expires <= self._now_ns] = FOREVER  # it has run out, and that is told
        last = np.ones(len(time_ns), dtype=np.bool_)
        last[:-1] = time_ns[1:] != time_ns[:-1]
        time_ns, codes = time_ns[last], codes[last]
        changed = _changes(codes)
        return Stretch(self.segment, time_ns[changed], codes[changed], self._now_ns)

    def _expiries(self, rows: Rows, at_ns: Times, end_ns: int) -> tuple[Times, NDArray[np.int32]]:
        """Return when lifetimes run out, up to the end, before the sensor is set anew; and of which."""
        old = np.flatnonzero(self._expires < FOREVER).astype(np.int32)
        if not len(old) and not (rows.expires_ns < FOREVER).any():
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int32)
        sensor = np.concatenate([old, rows.sensor])
        expires = np.concatenate([self._expires[old], rows.expires_ns])
        set_ns = np.concatenate([np.full(len(old), -FOREVER, dtype=np.int64), at_ns])
        order = np.argsort(sensor, kind="stable")  # by sensor, and within one by arrival
        sensor, expires, set_ns = sensor[order], expires[order], set_ns[order]
        until = np.full(len(sensor), end_ns, dtype=np.int64)
        same = sensor[1:] == sensor[:-1]
        until[:-1][same] = set_ns[1:][same]
        runs_out = (expires <= until) & (expires > set_ns)
        return expires[runs_out], sensor[runs_out]

    def _codes(self, sensor: NDArray[np.int32], bits: NDArray[np.uint64]) -> Codes:
        """Return the code after each row."""
        order = np.argsort(sensor, kind="stable")
        of, new = sensor[order], bits[order]
        first = np.ones(len(of), dtype=np.bool_)
        first[1:] = of[1:] != of[:-1]
        old = np.empty_like(new)
        old[1:] = new[:-1]
        word, shift = of // SENSORS_A_WORD, (2 * (of % SENSORS_A_WORD)).astype(np.uint64)
        old[first] = self._code[word[first]] >> shift[first] & np.uint64(3)
        flips = np.empty_like(new)
        flips[order] = (old ^ new) << shift
        codes = np.empty((len(sensor), len(self._code)), dtype=np.uint64)
        of_word = sensor // SENSORS_A_WORD
        for number, begun in enumerate(self._code):
            here = flips if len(self._code) == 1 else np.where(of_word == number, flips, np.uint64(0))
            codes[:, number] = np.bitwise_xor.accumulate(here) ^ begun
        if len(codes):
            self._code = codes[-1].copy()
        return codes

    def _remember(self, rows: Rows) -> None:
        """Note when each sensor was set last, and until when that counts."""
        self._time[rows.sensor] = rows.time_ns
        self._expires[rows.sensor] = rows.expires_ns


def _changes(codes: Codes) -> NDArray[np.bool_]:
    """Return which codes differ from the one before; the first does."""
    changed = np.ones(len(codes), dtype=np.bool_)
    if codes.shape[1] == 1:  # some three times as fast as rows of one word
        changed[1:] = codes[1:, 0] != codes[:-1, 0]
    else:
        changed[1:] = (codes[1:] != codes[:-1]).any(axis=1)
    return changed
