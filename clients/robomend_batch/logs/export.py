"""The service's own history: the observations in a file of `robomend export`, each robot a log of its own.

    {"robomend_export": 1, "schema": "0009"}
    {"table": "events", "row": {"robot": "r1", "revision": 7, "time_ns": …, "batch": "{\"e\": […]}", …}}
    …
    {"end": true, "rows": 4711}

What was observed while a drill was open is left out: its fault was planted. The rows are those of the store
(robomend.store.portable, and encoding.py for `batch`); the store itself is not imported, as that would need
a database's libraries. Up to schema 0008 batches were rows of `observations`, with their text in `data`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from robomend.observations.obs import FOREVER
from robomend_batch.logs.blocks import Block, Blocks, Opened, Place
from robomend_batch.logs.text import MOST_LOGS, TOGETHER, Gathered, Lines, gathered_blocks
from robomend_batch.problems import LogRefused
from robomend_client.literals import Atom, Literal

MAGIC = b'{"robomend_expor'
FORMAT = 1
_WITH_BATCHES = frozenset({"observations", "events"})


@dataclass
class ExportEnd:
    """Whether a file was read up to its last line."""

    whole: bool = False


def export_rows(
    path: Path, tables: frozenset[str], end: ExportEnd, begun: Lines | None = None
) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield place, table and row of an export; of a file that is cut off as much as there is.

    Raises:
        LogRefused: with the line that cannot be read.
    """
    lines = begun or Lines()
    with path.open("rb") as file:
        file.seek(lines.offset)
        for text in file:
            lines.count += 1
            lines.offset += len(text)
            number = lines.count
            place = f"{path}:{number}"
            try:
                line = json.loads(text.decode("utf-8", errors="replace"))
                if number == 1:
                    if line["robomend_export"] != FORMAT:
                        raise LogRefused(
                            f"an export of format {line['robomend_export']}, not {FORMAT}", place
                        )
                elif "end" in line:
                    end.whole = True
                elif line["table"] in tables:
                    yield place, line["table"], line["row"]
            except (ValueError, KeyError, TypeError) as error:
                if not text.endswith(b"\n"):
                    return
                raise LogRefused(f"no line of an export: {error!r}", place) from error


def batch_rows(
    path: Path, tables: frozenset[str], end: ExportEnd, begun: Lines | None = None
) -> Iterator[tuple[str, str | None, dict[str, Any]]]:
    """Yield place, text and row of each batch, and those of other tables with None for the text.

    Raises:
        LogRefused: as `export_rows`.
    """
    for place, table, row in export_rows(path, tables | _WITH_BATCHES, end, begun):
        if table in tables:
            yield place, None, row
            continue
        try:
            text = row["data" if table == "observations" else "batch"]
        except KeyError as error:
            raise LogRefused(f"no batch of observations: {error!r}", place) from error
        if text is not None:
            yield place, str(text), row


def drilled_spans(path: Path) -> dict[str, list[tuple[int, float]]]:
    """Return from and until which nanosecond each robot had drills; they come after what is observed."""
    found: dict[str, list[tuple[int, float]]] = {}
    with path.open(encoding="utf-8", errors="replace") as file:
        for text in file:
            if '"drills"' in text[:40]:  # the others are not even read as JSON
                with suppress(ValueError, KeyError, TypeError):
                    row = json.loads(text)["row"]
                    until = inf if row["open"] else row["updated_ns"]
                    found.setdefault(str(row["robot"]), []).append((row["created_ns"], until))
    return found


def read_export(path: Path, opened: Opened) -> Blocks:
    """Yield the blocks of an export; LogRefused if it cannot be read."""
    lines: Lines
    gathered: dict[str, Gathered]
    lines, gathered = opened.begun or (Lines(), dict[str, Gathered]())
    drilled = drilled_spans(path)
    size = max(1, path.stat().st_size)
    end = ExportEnd()
    rows = 0
    for place, text, row in batch_rows(path, frozenset(), end, lines):
        try:
            robot, entries = str(row["robot"]), _entries(text or "")
        except (ValueError, KeyError, TypeError) as error:
            raise LogRefused(f"no batch of observations: {error!r}", place) from error
        if robot not in gathered and len(gathered) >= MOST_LOGS:
            raise LogRefused(f"more than {MOST_LOGS} robots", place)
        words, into = opened.words(robot), gathered.setdefault(robot, Gathered())
        for literal, time_ns, expires_ns in entries:
            if any(first <= time_ns <= last for first, last in drilled.get(robot, ())):
                continue
            into.add(time_ns, words.settings(str(literal), place), expires_ns)
            rows += 1
        if rows >= TOGETHER:
            yield from gathered_blocks(gathered)
            yield Block("", Place((lines, gathered), lines.offset / size))
            rows = 0
    yield from gathered_blocks(gathered)
    if not end.whole:
        opened.problems.add(str(path), "cut off: an export ends with a line that says so", bad=True)
        opened.ended_early = True


def _entries(batch: str) -> list[tuple[Literal, int, int]]:
    """Return the literals of a batch with their times and when they expire."""
    found = []
    for predicate, arguments, positive, _, time_ns, *rest in json.loads(batch)["e"]:
        expires_ns = rest[0] if rest and rest[0] is not None else FOREVER
        literal = Literal(Atom(str(predicate), tuple(map(str, arguments))), bool(positive))
        found.append((literal, _ns(time_ns), _ns(expires_ns)))
    return found


def _ns(value: object) -> int:
    if not isinstance(value, int) or not -FOREVER <= value <= FOREVER:
        raise ValueError(f"a time that is {value!r}")
    return value
