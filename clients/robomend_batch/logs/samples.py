"""Recordings of the agent: what its observers were fed with (observers/recording.py), judged again."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from robomend_batch.logs.blocks import Advance, Block, Blocks, Opened, Place, Restart
from robomend_batch.logs.messages import Changes, Reported, Restarts
from robomend_batch.logs.text import Lines
from robomend_batch.problems import LogRefused
from robomend_client.observers.driver import Driver
from robomend_client.observers.recording import line_of, replay_line

TOGETHER = 4096
"""Lines between two places to go on from."""


@dataclass
class _Reading:
    """How far a recording was read."""

    changes: Changes
    driver: Driver | None = None
    lines: Lines = field(default_factory=Lines)
    restarts: Restarts = field(default_factory=Restarts)
    ended: bool = False


def read_recording(path: Path, opened: Opened) -> Blocks:
    """Yield the blocks of a recording of samples; LogRefused if it is none."""
    if opened.observing is None:
        raise LogRefused("a recording of samples needs --observers", str(path))
    reading: _Reading = opened.begun or _Reading(Changes(opened.words("")))
    lines = reading.lines
    try:
        yield from _replayed(reading, path, opened)
    except (ValueError, KeyError, TypeError) as error:
        raise LogRefused(f"no recording: {error}", f"{path}:{lines.count}") from error
    if reading.driver is None:
        raise LogRefused("an empty recording", str(path))
    yield from reading.changes.rest()
    yield Block("", Advance(reading.driver.now_ns))
    if not reading.ended:
        opened.problems.add(f"{path}:{lines.count}", "ended early: the agent did not close it", bad=True)
        opened.ended_early = True


def _replayed(reading: _Reading, path: Path, opened: Opened) -> Blocks:
    observing, lines, restarts = opened.observing, reading.lines, reading.restarts
    assert observing is not None
    size = max(1, path.stat().st_size)
    with path.open("rb") as file:
        file.seek(lines.offset)
        for text in file:
            lines.count += 1
            lines.offset += len(text)
            line = line_of(text.decode("utf-8", errors="replace"))
            if line is None:
                return
            reading.ended = "end" in line
            if reading.driver is None:
                start_ns = int(line["start"])
                reading.driver = Driver(
                    [spec.make() for spec in observing.specs],
                    start_ns,
                    lenient=observing.lenient,
                    on_problem=Reported(str(path), opened.problems),
                    listeners=(restarts,),
                )
                yield Block("", Restart(start_ns))
                continue
            for change in replay_line(reading.driver, line):
                yield from reading.changes.take([change], restarts.take())
            if lines.count % TOGETHER == 0:
                yield Block("", Place(reading, lines.offset / size))
