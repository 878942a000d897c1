"""Observed literals in text: NDJSON and CSV, line by line.

    {"time": 1764000000000000000, "literal": "not ok(scan)", "lifetime": 5}        long
    {"time": 1764000000000000000, "observations": ["ok(scan)", "on(jaguar)"]}      as POST …/observations
    {"time": 1764000000000000000, "ok(scan)": true, "on(jaguar)": null}            wide: null is unknown

CSV has the same columns, `time,literal,lifetime` or `time,ok(scan),on(jaguar)`. A column `log` tells several
logs of one file apart. A last line without its end, which cannot be read, is where the writer died.
"""

from __future__ import annotations

import csv
import json
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robomend.observations.obs import FOREVER
from robomend_batch.logs.blocks import Block, Blocks, Opened, Place
from robomend_batch.logs.stamps import expires_ns, time_ns
from robomend_batch.problems import LogRefused
from robomend_batch.track import Rows
from robomend_batch.words import FALSE, TRUE, UNKNOWN, Setting, Words

TOGETHER = 1 << 16
"""Rows of a block."""

MOST_LOGS = 10_000
"""Logs of one file."""

LONGEST = 1 << 20
"""Characters of a line."""

LITERAL, LIFETIME = ("literal", "observation"), ("lifetime", "lifetime_s")
OTHERS = ("log", "time", "source", "since", "onset", "unknown", "agent", "observations", *LITERAL, *LIFETIME)
"""Keys that are no atoms."""

WORDS = {"true": True, "1": True, "false": False, "0": False, "": None, "null": None}
"""What a cell of a wide table says."""


class Gathered:
    """Rows of one log, until they are a block."""

    def __init__(self) -> None:
        self.time, self.expires = array("q"), array("q")
        self.sensor, self.value = array("i"), array("b")

    def add(self, at_ns: int, settings: Iterable[Setting], until_ns: int) -> None:
        for sensor, value in settings:
            self.time.append(at_ns)
            self.sensor.append(sensor)
            self.value.append(value)
            self.expires.append(until_ns)

    def rows(self) -> Rows:
        return Rows(
            np.array(self.time, dtype=np.int64),
            np.array(self.sensor, dtype=np.int32),
            np.array(self.value, dtype=np.int8),
            np.array(self.expires, dtype=np.int64),
        )


def read_ndjson(path: Path, opened: Opened) -> Blocks:
    """Yield the blocks of a file of JSON lines; LogRefused with the line that cannot be read."""
    begun: _Reading = opened.begun or _Reading()
    yield from _blocks(path, opened, ndjson_lines(path, begun.lines), begun)


def read_csv(path: Path, opened: Opened) -> Blocks:
    """Yield the blocks of a CSV file; LogRefused with the line that cannot be read."""
    begun: _Reading = opened.begun or _Reading()
    yield from _blocks(path, opened, csv_lines(path, begun.lines), begun)


Line = tuple[int, bool, Mapping[str, Any] | str]
"""Its number, whether it is whole, and its values, or why there are none."""


@dataclass
class Lines:
    """How far the lines of a file were read."""

    count: int = 0
    offset: int = 0  # of the next one
    header: list[str] | None = None  # of a CSV file


@dataclass
class _Reading:
    """How far a file was read."""

    lines: Lines = field(default_factory=Lines)
    gathered: dict[str, Gathered] = field(default_factory=dict)
    wide: dict[str, dict[str, tuple[Setting, ...]]] = field(default_factory=dict)


def _lines(path: Path, lines: Lines) -> Iterator[tuple[int, bool, str]]:
    with path.open("rb") as file:
        file.seek(lines.offset)
        for line in iter(lambda: file.readline(LONGEST + 1), b""):
            lines.count += 1
            lines.offset += len(line)
            number = lines.count
            if len(line) > LONGEST:
                raise LogRefused(f"a line of more than {LONGEST} bytes", f"{path}:{number}")
            text = line.decode("utf-8-sig" if number == 1 else "utf-8", errors="replace")
            if text.strip():
                yield number, text.endswith("\n"), text


def ndjson_lines(path: Path, begun: Lines | None = None) -> Iterator[Line]:
    for number, whole, text in _lines(path, begun or Lines()):
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            yield number, whole, "not a line of JSON"
            continue
        yield number, whole, found if isinstance(found, dict) else "not a JSON object"


def csv_lines(path: Path, begun: Lines | None = None) -> Iterator[Line]:
    lines = begun or Lines()
    for number, whole, text in _lines(path, lines):
        try:
            cells = next(csv.reader([text], strict=True))
        except (csv.Error, StopIteration):
            yield number, whole, "not a line of CSV"
            continue
        header = lines.header
        if header is None:
            header = lines.header = [cell.strip() for cell in cells]
            if len(set(header)) < len(header):
                raise LogRefused("a column is there twice", f"{path}:{number}")
        elif len(cells) != len(header):
            yield number, whole, f"{len(cells)} cells, and {len(header)} columns"
        else:
            yield number, whole, dict(zip(header, cells, strict=True))


def _blocks(path: Path, opened: Opened, lines: Iterator[Line], begun: _Reading) -> Blocks:
    gathered, wide = begun.gathered, begun.wide
    size = max(1, path.stat().st_size)
    rows = 0
    for number, whole, line in lines:
        place = f"{path}:{number}"
        try:
            if isinstance(line, str):
                raise LogRefused(line, place)
            log = line.get("log")
            log = "" if log is None else str(log)
            if log not in gathered and len(gathered) >= MOST_LOGS:
                raise LogRefused(f"more than {MOST_LOGS} logs in one file", place)
            into = gathered.setdefault(log, Gathered())
            rows += _take(line, opened.words(log), into, wide.setdefault(log, {}), place)
        except LogRefused as error:
            if whole:
                yield from gathered_blocks(gathered)
                raise
            opened.problems.add(place, f"cut off here: {error.reason}", bad=True)
            opened.ended_early = True
            break
        if rows >= TOGETHER:
            yield from gathered_blocks(gathered)
            yield Block("", Place(begun, begun.lines.offset / size))
            rows = 0
    yield from gathered_blocks(gathered)


def gathered_blocks(gathered: dict[str, Gathered]) -> Blocks:
    for log, some in gathered.items():
        if some.time:
            yield Block(log, some.rows())
            gathered[log] = Gathered()


def _take(
    line: Mapping[str, Any],
    words: Words,
    into: Gathered,
    wide: dict[str, tuple[Setting, ...]],
    place: str,
) -> int:
    """Take in one line; return how many rows it made."""
    before = len(into.time)
    try:
        if "time" not in line:
            raise ValueError("it has no `time`")
        at_ns = time_ns(line["time"])
        until_ns = FOREVER
        for key in LIFETIME:
            if key in line:
                until_ns = expires_ns(at_ns, line[key])
    except ValueError as error:
        raise LogRefused(str(error), place) from error
    sentences = line.get("observations")
    if sentences is None:
        sentences = [line[key] for key in LITERAL if key in line]
    if sentences or "observations" in line:
        if not isinstance(sentences, list):
            raise LogRefused("`observations` is a list of sentences", place)
        for sentence in sentences:
            if not isinstance(sentence, str):
                raise LogRefused(f"a literal is a string, not {sentence!r}", place)
            into.add(at_ns, words.settings(sentence, place), until_ns)
    else:
        _take_wide(line, words, into, wide, at_ns, until_ns, place)
    return len(into.time) - before


def _take_wide(
    line: Mapping[str, Any],
    words: Words,
    into: Gathered,
    wide: dict[str, tuple[Setting, ...]],
    at_ns: int,
    until_ns: int,
    place: str,
) -> None:
    """A row is all that was known at its time: what it does not say is unknown."""
    if not any(key not in OTHERS for key in line):
        raise LogRefused("neither a `literal` nor a column for an atom", place)
    for key in line:
        if key not in OTHERS and key not in wide:
            wide[key] = words.settings(key, place)
    settings: dict[int, int] = {sensor: UNKNOWN for said in wide.values() for sensor, _ in said}
    for key, said in wide.items():
        value = _cell(line.get(key), place)
        if value is not None:
            settings.update(said if value else opposite(said))
    into.add(at_ns, settings.items(), until_ns)


def opposite(said: tuple[Setting, ...]) -> tuple[Setting, ...]:
    """Return what the negation of a literal sets: it denies nothing else."""
    sensor, value = said[0]
    return ((sensor, FALSE if value == TRUE else TRUE),)


def _cell(value: object, place: str) -> bool | None:
    if value is None or isinstance(value, bool):
        return value
    found = WORDS.get(str(value).strip().lower(), "")
    if found == "":
        raise LogRefused(f"an atom is true, false or unknown (empty, null), not {value!r}", place)
    return found  # type: ignore[return-value]  # the table's values
