"""Observed literals in Parquet, in blocks: never the whole file, and no step of Python for each row.

    long    time, literal, and if wanted lifetime and log
    wide    time, a column for each atom (true, false; null is unknown), and if wanted log

Times are integers (nanoseconds), numbers with fractions (seconds) or time stamps; lifetimes seconds or
durations.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robomend.diagnosis.library import SENSORS_A_WORD
from robomend.observations.obs import FOREVER
from robomend_batch.logs.blocks import Block, Blocks, Opened, Place, Shown
from robomend_batch.logs.stamps import LATEST_NS
from robomend_batch.logs.text import LIFETIME, LITERAL, MOST_LOGS
from robomend_batch.problems import LogRefused
from robomend_batch.track import STATES, Rows
from robomend_batch.words import TRUE, Setting, Words

if TYPE_CHECKING:
    import polars as pl

TOGETHER = 1 << 17
"""Rows of a block."""

TIME_NS, UNTIL_NS, WORD = "\0time", "\0until", "\0word"
"""Names of columns that we make; no file has them."""


def read_parquet(path: Path, opened: Opened) -> Blocks:
    """Yield the blocks of a Parquet file; LogRefused with the column or row that cannot be read."""
    import polars as pl

    try:
        scan = pl.scan_parquet(path, glob=False)
        columns = scan.collect_schema()
    except (pl.exceptions.PolarsError, OSError) as error:
        raise LogRefused(f"not a whole Parquet file: {_short(error)}", str(path)) from error
    if "time" not in columns:
        raise LogRefused(f"it has no column `time`, but {', '.join(columns) or 'none'}", str(path))
    literal = next((name for name in LITERAL if name in columns), None)
    lifetime = next((name for name in LIFETIME if name in columns), None)
    known = {"time", "log", literal, lifetime}
    others = [name for name in columns if name not in known]
    if literal is None and (not others or lifetime is not None):
        others = [name for name in columns if name != "time"]
        raise LogRefused(
            "neither a column `literal` nor one for each atom beside time: it has "
            f"{', '.join(others) or 'none'}",
            str(path),
        )
    if literal is not None and others:
        raise LogRefused(
            f"it has the columns {', '.join(others)} beside `{literal}`; known are log, time, lifetime",
            str(path),
        )
    try:
        if literal is not None:
            yield from _long(scan, columns, literal, lifetime, path, opened)
        else:
            yield from _wide(scan, columns, others, path, opened)
    except pl.exceptions.PolarsError as error:
        raise LogRefused(f"damaged: {_short(error)}", str(path)) from error


def _long(
    scan: pl.LazyFrame, columns: pl.Schema, literal: str, lifetime: str | None, path: Path, opened: Opened
) -> Blocks:
    import polars as pl

    if columns[literal] not in (pl.String, pl.Categorical, pl.Enum):
        raise LogRefused(f"the column `{literal}` holds {columns[literal]}, not text", str(path))
    wanted = [_time(columns, path), pl.col(literal).cast(pl.String)]
    if lifetime is not None:
        wanted.append(_lifetime(columns, lifetime, path))
    if "log" in columns:
        wanted.append(pl.col("log").cast(pl.String).fill_null(""))
    rows_of_file = _rows_of(scan)
    for start, frame in _frames(scan.select(wanted), opened):
        _check(frame, (TIME_NS, literal), start, path)
        for log, rows in _by_log(frame):
            yield Block(log, _rows(rows, literal, lifetime is not None, opened.words(log), path))
        yield Block("", _place(start + len(frame), rows_of_file))


def _rows(frame: pl.DataFrame, literal: str, mortal: bool, words: Words, path: Path) -> Rows:
    import polars as pl

    said = frame[literal]
    different = said.unique(maintain_order=True)
    settings = [words.settings(sentence, str(path)) for sentence in different.to_list()]
    numbers = pl.Series(range(len(different)), dtype=pl.Int32)
    which = said.replace_strict(different, numbers, return_dtype=pl.Int32).to_numpy()
    count = np.array([len(one) for one in settings], dtype=np.int64)
    if len(settings) and (count == 1).all():
        row = np.arange(len(frame))
        place = which
        flat = [one[0] for one in settings]
    else:  # a row that says several things is several
        row = np.repeat(np.arange(len(frame)), count[which])
        begins = np.concatenate([[0], np.cumsum(count)[:-1]])
        ends = np.cumsum(count[which])
        place = begins[which][row] + np.arange(len(row)) - (ends - count[which])[row]
        flat = [one for said_by in settings for one in said_by]
    sensor = np.array([number for number, _ in flat], dtype=np.int32)
    value = np.array([shown for _, shown in flat], dtype=np.int8)
    time_ns = frame[TIME_NS].to_numpy()[row]
    until = frame[UNTIL_NS].to_numpy()[row] if mortal else np.full(len(row), FOREVER, dtype=np.int64)
    return Rows(time_ns, sensor[place], value[place], until)


def _wide(scan: pl.LazyFrame, columns: pl.Schema, names: list[str], path: Path, opened: Opened) -> Blocks:
    import polars as pl

    for name in names:
        if columns[name] != pl.Boolean and not columns[name].is_integer() and columns[name] != pl.Null:
            raise LogRefused(f"the column `{name}` holds {columns[name]}, not true and false", str(path))
    atoms = [name for name in names if columns[name] != pl.Null]
    if "log" not in columns:  # one log: its bits are made where the columns are
        words = opened.words("")
        said = {name: words.settings(name, f"{path}: column {name}") for name in names}
        if _simple(said):
            yield from _packed(scan, columns, said, atoms, path, opened)
            return
    wanted = [_time(columns, path), *(_truth(columns, name).alias(name) for name in atoms)]
    if "log" in columns:
        wanted.append(pl.col("log").cast(pl.String).fill_null(""))
    rows_of_file = _rows_of(scan)
    for start, frame in _frames(scan.select(wanted), opened):
        _check(frame, (TIME_NS,), start, path)
        for log, rows in _by_log(frame):
            words = opened.words(log)
            said = {name: words.settings(name, f"{path}: column {name}") for name in names}
            yield Block(log, Shown(rows[TIME_NS].to_numpy(), _codes(rows, said, atoms, words)))
        yield Block("", _place(start + len(frame), rows_of_file))


def _simple(said: dict[str, tuple[Setting, ...]]) -> bool:
    """Return whether each column is a sensor of its own, and denies nothing of others."""
    sensors = [one[0][0] for one in said.values()]
    return all(len(one) == 1 for one in said.values()) and len(set(sensors)) == len(sensors)


def _packed(
    scan: pl.LazyFrame,
    columns: pl.Schema,
    said: dict[str, tuple[Setting, ...]],
    atoms: list[str],
    path: Path,
    opened: Opened,
) -> Blocks:
    import polars as pl

    count = max(1, -(-len(said) // SENSORS_A_WORD))
    terms: list[list[pl.Expr]] = [[pl.lit(0, pl.UInt64)] for _ in range(count)]
    two = pl.lit(2, pl.UInt64)
    for name in atoms:
        sensor, value = said[name][0]
        word, place = divmod(sensor, SENSORS_A_WORD)
        seen = _truth(columns, name).cast(pl.UInt64)
        bits = (two - seen if value == TRUE else seen + pl.lit(1, pl.UInt64)).fill_null(0)
        terms[word].append(bits * pl.lit(1 << (2 * place), pl.UInt64))
    wanted = [_time(columns, path)]
    wanted += [pl.sum_horizontal(some).alias(f"{WORD}{word}") for word, some in enumerate(terms)]
    integers = [name for name in atoms if columns[name].is_integer()]
    wanted += [(pl.col(name).is_between(0, 1) | pl.col(name).is_null()).alias(name) for name in integers]
    rows_of_file = _rows_of(scan)
    for start, frame in _frames(scan.select(wanted), opened):
        _check(frame, (TIME_NS,), start, path)
        for name in integers:
            if not frame[name].all():
                raise LogRefused(f"the column `{name}` holds other numbers than 0 and 1", str(path))
        codes = [frame[f"{WORD}{word}"].to_numpy() for word in range(count)]
        yield Block("", Shown(frame[TIME_NS].to_numpy(), np.stack(codes, axis=1)))
        yield Block("", _place(start + len(frame), rows_of_file))


def _codes(frame: pl.DataFrame, said: dict[str, tuple[Setting, ...]], atoms: list[str], words: Words) -> Any:
    """Return the codes of rows whose columns may deny what others say: the later column counts, as in OBS."""
    count = max(1, -(-len(words.sensors) // SENSORS_A_WORD))
    codes = np.zeros((len(frame), count), dtype=np.uint64)

    def put(rows: Any, sensor: int, value: int) -> None:
        word, place = divmod(sensor, SENSORS_A_WORD)
        codes[rows, word] &= ~(np.uint64(3) << np.uint64(2 * place))
        codes[rows, word] |= STATES[value] << np.uint64(2 * place)

    for name in atoms:
        seen = frame[name]
        holds = seen.fill_null(False).to_numpy()
        fails = (~seen).fill_null(False).to_numpy()
        for sensor, value in said[name]:
            put(holds, sensor, value)
        sensor, value = said[name][0]
        put(fails, sensor, 1 - value)
    return codes


def _truth(columns: pl.Schema, name: str) -> pl.Expr:
    import polars as pl

    return pl.col(name) if columns[name] == pl.Boolean else pl.col(name) != 0


def _time(columns: pl.Schema, path: Path) -> pl.Expr:
    import polars as pl

    kind, column = columns["time"], pl.col("time")
    if isinstance(kind, pl.Datetime):
        return column.dt.cast_time_unit("ns").dt.timestamp("ns").alias(TIME_NS)
    if kind.is_integer():
        return column.cast(pl.Int64, strict=False).alias(TIME_NS)
    if kind.is_float():
        seconds = column.cast(pl.Float64).fill_nan(None)
        return (seconds * 1e9).round().cast(pl.Int64, strict=False).alias(TIME_NS)
    raise LogRefused(f"the column `time` holds {kind}, which is no time", str(path))


def _lifetime(columns: pl.Schema, name: str, path: Path) -> pl.Expr:
    import polars as pl

    kind, column = columns[name], pl.col(name)
    if kind.is_numeric():
        ns = (column.cast(pl.Float64).fill_nan(None) * 1e9).round()
    elif isinstance(kind, pl.Duration):
        ns = column.dt.total_nanoseconds().cast(pl.Float64)
    elif kind == pl.Null:
        return pl.lit(FOREVER, pl.Int64).alias(UNTIL_NS)
    else:
        raise LogRefused(f"the column `{name}` holds {kind}, not seconds", str(path))
    most = float(LATEST_NS // 2)
    until = _time(columns, path) + ns.clip(0, most).cast(pl.Int64)
    return (
        pl.when(ns.is_null() | (ns >= most)).then(pl.lit(FOREVER, pl.Int64)).otherwise(until).alias(UNTIL_NS)
    )


def _frames(scan: pl.LazyFrame, opened: Opened) -> Iterator[tuple[int, pl.DataFrame]]:
    """Yield blocks of rows, and the number of the first of each, from where an earlier reading was left."""
    start: int = opened.begun or 0
    for frame in (scan.slice(start) if start else scan).collect_batches(chunk_size=TOGETHER):
        if len(frame):
            yield start, frame.rechunk()
            start += len(frame)


def _rows_of(scan: pl.LazyFrame) -> int:
    """Return how many rows a file has, as its end says."""
    import polars as pl

    return int(scan.select(pl.len()).collect().item())


def _place(row: int, rows: int) -> Place:
    return Place(row, row / max(1, rows))


def _by_log(frame: pl.DataFrame) -> Iterator[tuple[str, pl.DataFrame]]:
    if "log" not in frame.columns:
        yield "", frame
        return
    parts = frame.partition_by("log", maintain_order=True)
    if len(parts) > MOST_LOGS:
        raise LogRefused(f"more than {MOST_LOGS} logs in one file", "")
    for part in parts:
        yield part["log"][0], part


def _check(frame: pl.DataFrame, names: tuple[str, ...], start: int, path: Path) -> None:
    """Refuse rows without a value where there must be one."""
    for name in names:
        missing = frame[name].is_null()
        if missing.any():
            row = start + int(missing.arg_max() or 0)
            raise LogRefused(f"no {name.strip(chr(0))}", f"{path}: row {row}")


def _short(error: Exception) -> str:
    return str(error).splitlines()[0][:200]
