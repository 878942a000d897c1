"""Intervals of one log, written in parts: Parquet files, each written beside and renamed.

    codes ──► answers ──► equal neighbours are one interval ──► OUT/results/NAME-000.parquet, NAME-001…

A part is closed when it has PART intervals, so that a log of any length takes the same memory; its lists
are spread out for GROUP of them at once, a row group of the file. The last interval of a part waits for the
next one, as its neighbour may be its equal.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robomend.diagnosis.library import SENSORS_A_WORD, Codes, distinct
from robomend_batch.answers import NOTHING, Answers, Told, widened
from robomend_batch.track import Stretch, Times
from robomend_client.literals import Atom

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    import polars as pl
    from numpy.typing import NDArray

    Write = Callable[[Iterator[pl.DataFrame], Iterable[bytes]], None]

PART = 250_000
"""Codes that are answered together."""

GROUP = 1 << 15
"""Rows of a row group."""

SPREAD = 1 << 13
"""Rows whose lists are texts at once, on their way to a row group."""

DECODED = 1 << 20
"""Characters of JSON that become lists together."""

WRITTEN: dict[str, Any] = {
    "compression": "zstd",
    "compression_level": 1,  # as small as with more, in less time
    "statistics": True,
    "row_group_size": GROUP,
    "maintain_order": True,
}
"""How Parquet is written: equal rows are equal bytes."""

PIECE = ".ndjson"
"""The ending of the lines of a part, which are there until results.ndjson is."""

SCHEMA_VERSION = 1

COLUMNS = 2
"""Counts up when a column joins: parts of one folder have the same ones."""


def schema() -> pl.Schema:
    """Return the columns of the results; docs/batch.md says what they mean."""
    import polars as pl

    names = pl.List(pl.String)
    return pl.Schema(
        {
            "log": pl.String(),
            "segment": pl.Int32(),
            "start_ns": pl.Int64(),
            "end_ns": pl.Int64(),
            "state": pl.String(),
            "bad": pl.List(names),
            "probability": pl.List(pl.Float64),
            "conflicts": pl.List(names),
            "observations": names,
            "complete": pl.Boolean(),
            "stopped_by": pl.String(),
            "smallest_proved": pl.Boolean(),
            "size_at_least": pl.Int32(),
            "size_at_most": pl.Int32(),
        }
    )


class Parts:
    """Takes the stretches of one log, and writes its intervals."""

    def __init__(
        self,
        log: str,
        answers: Answers,
        sensors: Callable[[], tuple[Atom, ...]],
        write: Write,
    ) -> None:
        self._log = log
        self._answers = answers
        self._sensors = sensors
        self._write = write
        self._segment: list[np.ndarray[Any, np.dtype[np.int32]]] = []
        self._start: list[Times] = []
        self._end: list[Times] = []
        self._codes: list[Codes] = []
        self._waiting = 0
        self._open: tuple[int, int, Codes] | None = None  # segment, start and code of what goes on
        self._open_end_ns = 0
        self.intervals: Counter[str] = Counter()
        self.span_ns: Counter[str] = Counter()
        self.start_ns: int | None = None
        self.end_ns: int | None = None

    def add(self, stretch: Stretch) -> None:
        """Take in what held; the last code goes on until the next stretch says otherwise."""
        if self._open is not None and self._open[0] != stretch.segment:
            self._close(self._open_end_ns, last=True)
        if self._open is not None and len(stretch.time_ns):
            self._close(int(stretch.time_ns[0]))
        times, codes = stretch.time_ns, stretch.codes
        if len(times):
            if len(times) > 1:
                self._take(stretch.segment, times[:-1], times[1:], codes[:-1])
            self._open = stretch.segment, int(times[-1]), codes[-1:]
        self._open_end_ns = max(stretch.end_ns, self._open[1]) if self._open else stretch.end_ns
        if self._waiting >= PART:
            self._flush(last=False)

    def finish(self) -> None:
        """Write what is left."""
        if self._open is not None:
            self._close(self._open_end_ns, last=True)
        self._flush(last=True)

    def _close(self, end_ns: int, last: bool = False) -> None:
        """End what goes on, at this time; what held for no time is told at the end of a segment only."""
        assert self._open is not None
        (segment, start_ns, code), self._open = self._open, None
        if end_ns > start_ns or last:
            at = np.array([start_ns], dtype=np.int64)
            self._take(segment, at, np.array([end_ns], dtype=np.int64), code)

    def _take(self, segment: int, start: Times, end: Times, codes: Codes) -> None:
        self._segment.append(np.full(len(start), segment, dtype=np.int32))
        self._start.append(start)
        self._end.append(end)
        self._codes.append(codes)
        self._waiting += len(start)

    def _flush(self, last: bool) -> None:
        if not self._waiting:
            return
        sensors = self._sensors()
        segment, start, end, codes = self._taken(sensors)
        told, numbers = self._answers.told(codes, sensors)
        first = np.ones(len(numbers), dtype=np.bool_)
        first[1:] = (numbers[1:] != numbers[:-1]) | (segment[1:] != segment[:-1]) | (start[1:] != end[:-1])
        begins = np.flatnonzero(first)
        ends = end[np.append(begins[1:], len(end)) - 1]
        begun = begins, start[begins], ends, segment[begins], codes[begins], numbers[begins]
        if not last:
            keep = slice(-1, None)  # its neighbour may be its equal
            self._take(int(begun[3][-1]), begun[1][keep], begun[2][keep], begun[4][keep])
            begun = tuple(column[:-1] for column in begun)  # type: ignore[assignment]  # the same six
        _, start, end, segment, codes, numbers = begun
        if len(start):
            self._told(segment, start, end, told, numbers, *self._answers.grounds(codes, sensors))

    def _taken(
        self, sensors: tuple[Atom, ...]
    ) -> tuple[np.ndarray[Any, np.dtype[np.int32]], Times, Times, Codes]:
        """Return segment, start, end and code of what waits, and forget it."""
        words = max(1, -(-len(sensors) // SENSORS_A_WORD))
        codes = np.concatenate([widened(some, words) for some in self._codes])
        segment, start = np.concatenate(self._segment), np.concatenate(self._start)
        end = np.concatenate(self._end)
        self._segment, self._start, self._end, self._codes = [], [], [], []
        self._waiting = 0
        return segment, start, end, codes

    def _told(
        self,
        segment: np.ndarray[Any, np.dtype[np.int32]],
        start: Times,
        end: Times,
        different: list[Told],
        numbers: np.ndarray[Any, np.dtype[np.intp]],
        grounds: Iterable[list[str]],
        ground_of: np.ndarray[Any, np.dtype[np.intp]],
    ) -> None:
        """Write intervals, and count them."""
        import polars as pl

        columns = schema()
        used, of = np.unique(numbers, return_inverse=True)
        told = [different[number] for number in used.tolist()]
        fields = (*BEFORE, *AFTER)
        components = pl.Enum(self._answers.components)
        answers = pl.DataFrame(
            [
                _column(name, (getattr(one, name) for one in told), columns[name], components)
                for name in fields
            ]
        )
        said = pl.Enum(self._answers.said(self._sensors()))
        observations = _column("observations", grounds, columns["observations"], said)
        of = of.reshape(-1)

        def groups() -> Iterator[pl.DataFrame]:
            for first in range(0, len(start), SPREAD):
                here = slice(first, first + SPREAD)
                yield (
                    answers[of[here]]
                    .with_columns(
                        pl.lit(self._log).alias("log"),
                        pl.Series("segment", segment[here]),
                        pl.Series("start_ns", start[here]),
                        pl.Series("end_ns", end[here]),
                        observations[ground_of[here]],
                    )
                    .select(pl.col(column).cast(kind) for column, kind in columns.items())
                )

        self._write(groups(), lines(self._log, segment, start, end, answers, of, observations, ground_of))
        states = [one.state for one in told]
        counts, spans = np.bincount(of), np.zeros(len(told), dtype=np.int64)
        np.add.at(spans, of, end - start)
        for state, count, span in zip(states, counts.tolist(), spans.tolist(), strict=True):
            self.intervals[state] += count
            self.span_ns[state] += span
        self.start_ns = int(start[0]) if self.start_ns is None else min(self.start_ns, int(start.min()))
        self.end_ns = int(end.max()) if self.end_ns is None else max(self.end_ns, int(end.max()))


def _column(name: str, values: Iterable[Any], kind: pl.DataType, texts: pl.Enum) -> pl.Series:
    """Return a column; if it is long, numbers stand for the texts in its lists, of which there are few.

    Lists of texts go by way of JSON: that is six times as fast as list by list.
    """
    import polars as pl

    if kind not in (pl.List(pl.String), pl.List(pl.List(pl.String))):
        lists = [list(value) if isinstance(value, tuple) else value for value in values]
        return pl.Series(name, lists, dtype=kind)
    numbered = pl.List(texts) if kind == pl.List(pl.String) else pl.List(pl.List(texts))
    pieces: list[pl.Series] = []
    column = pl.Series(name, [], dtype=kind)
    for some in _json_texts(values):
        column = pl.Series(name, some, dtype=pl.String).str.json_decode(kind)
        pieces.append(column.cast(numbered))
    return column if len(pieces) < 2 else pl.concat(pieces, rechunk=True)  # short: spread out the faster


class _Quoted(dict[str, str]):
    """Names as JSON: there are few of them, in very many lists."""

    def __missing__(self, name: str) -> str:
        text = self[name] = json.dumps(name)
        return text

    def list(self, value: Sequence[Any]) -> str:
        """Return a list of names, or of lists of them, as JSON."""
        if value and not isinstance(value[0], str):
            return f"[{','.join(map(self.list, value))}]"
        return f"[{','.join(map(self.__getitem__, value))}]"


def _json_texts(values: Iterable[Any]) -> Iterator[list[str | None]]:
    """Yield values as JSON, DECODED characters at once: decoding takes ten times the memory that they do."""
    texts: list[str | None] = []
    quoted = _Quoted()
    size = 0
    for value in values:
        texts.append(None if value is None else quoted.list(value))
        size += len(texts[-1] or "")
        if size >= DECODED:
            yield texts
            texts, size = [], 0
    if texts:
        yield texts


@dataclass(frozen=True, slots=True)
class PartFolder:
    """Where parts are written, and whether their lines are beside them, for results.ndjson."""

    path: Path
    ndjson: bool


class PartFiles:
    """The files of one log."""

    def __init__(self, folder: PartFolder, name: str) -> None:
        self._folder = folder
        self._name = name
        self.written: list[str] = []

    def drop(self) -> None:
        """Remove what was written."""
        for part in self.written:
            file = self._folder.path / part
            write_piece(file, ())
            file.unlink(missing_ok=True)

    def write(self, groups: Iterator[pl.DataFrame], texts: Iterable[bytes] = ()) -> None:
        """Write the next one, of these row groups; its lines beside it, if wanted."""
        file = self._folder.path / f"{self._name}-{len(self.written):03}.parquet"
        data = BytesIO()  # so that a full disk is an OSError with its number
        _write_groups(groups, data)
        beside = file.with_suffix(f".{os.getpid()}.tmp")  # the worker of a killed run may not be gone yet
        beside.write_bytes(data.getbuffer())
        write_piece(file, texts if self._folder.ndjson else ())
        os.replace(beside, file)
        self.written.append(file.name)


def _write_groups(groups: Iterator[pl.DataFrame], into: BytesIO) -> None:
    """Write a Parquet file, one row group after another; there is never more than a few of them."""
    from polars.io.plugins import register_io_source

    register_io_source(lambda *_: groups, schema=schema()).sink_parquet(into, **WRITTEN)


def write_piece(part: Path, texts: Iterable[bytes]) -> None:
    """Write the lines of a part beside it; without any, remove those of an older part of this name."""
    piece = part.with_suffix(PIECE)
    beside = piece.with_suffix(f".{os.getpid()}.lines.tmp")
    with beside.open("wb") as file:
        for text in texts:
            file.write(text)
    if beside.stat().st_size:
        os.replace(beside, piece)
    else:
        beside.unlink()
        piece.unlink(missing_ok=True)


# --- one explanation for a whole log, or for each window of it: the faults that explain all that was seen
# there.
#
#     states of a window ──► what each rests on ──► distinct ones ──► SnapshotEngine ──► one row
#
# What is broken is taken to be broken all the while, and what was seen of it may come and go: a fault that
# shows in one state is none the less a fault in the others. So a window in which one thing failed after
# another has both in its diagnoses.

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


# --- intervals as lines of JSON, made while what they have in common is at hand.
#
# A log has few different answers, and few different grounds: each is written as JSON once, by polars, and a
# line is put together of its times and these texts. The bytes are those of polars' own `write_ndjson` of
# the part (a test holds the two together), which has to read every list of every row for them.

SLICE = 2048
"""Lines that are made together: they stay in the processor's cache."""

TAILS = 1 << 15
"""Lines whose different ends are made together."""

BEFORE = ("state", "bad", "probability", "conflicts")
AFTER = ("complete", "stopped_by", "smallest_proved", "size_at_least", "size_at_most")
"""Columns before and behind the observations."""


def lines(
    log: str,
    segment: NDArray[np.int32],
    start: Times,
    end: Times,
    answers: pl.DataFrame,
    answer_of: NDArray[np.intp],
    observations: pl.Series,
    ground_of: NDArray[np.intp],
) -> Iterator[bytes]:
    """Yield the lines of intervals, many at once.

    Args:
        log: its name.
        segment, start, end: of each interval.
        answers: the different ones.
        answer_of: which of them each interval has.
        observations: the different grounds.
        ground_of: which of them each interval has.
    """
    import polars as pl

    head = b"{" + _texts(pl.DataFrame({"log": [log]}))[0] + b',"segment":'
    before, after = _texts(answers.select(BEFORE)), _texts(answers.select(AFTER))
    grounds = _texts(observations.to_frame("observations"))
    pair = answer_of.astype(np.int64) * len(grounds) + ground_of
    for group in range(0, len(start), TAILS):
        different, tail_of = np.unique(pair[group : group + TAILS], return_inverse=True)
        tails = [
            b",%b,%b,%b}\n" % (before[answer], grounds[ground], after[answer])
            for answer, ground in (divmod(one, len(grounds)) for one in different.tolist())
        ]
        for first in range(0, len(tail_of), SLICE):
            here = slice(group + first, min(group + first + SLICE, group + len(tail_of)))
            columns = segment[here].tolist(), start[here].tolist(), end[here].tolist()
            tail = tail_of[first : first + SLICE].tolist()
            yield b"".join(
                [
                    piece
                    for number, begins, ends, of in zip(*columns, tail, strict=True)
                    for piece in (b'%b%d,"start_ns":%d,"end_ns":%d' % (head, number, begins, ends), tails[of])
                ]
            )


def _texts(frame: pl.DataFrame) -> list[bytes]:
    """Return the rows of a table as JSON, without their braces."""
    texts: list[bytes] = []
    for piece in frame.iter_slices(SLICE):
        text = BytesIO()
        piece.write_ndjson(text)
        texts += [line[1:-1] for line in text.getvalue().split(b"\n")[: len(piece)]]
    return texts
