"""Recordings of the agent: what its observers were fed with (observers/recording.py), judged again."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from robomend_batch.logs.blocks import Advance, Block, Blocks, Opened, Restart
from robomend_batch.logs.messages import Changes
from robomend_batch.problems import LogRefused
from robomend_client.observers.driver import Driver
from robomend_client.observers.listener import Listener
from robomend_client.observers.recording import replay


class _Watch(Listener):
    """Notes where time begins again."""

    restart_ns: int | None = None

    def restart(self, now_ns: int) -> None:
        self.restart_ns = now_ns


def read_recording(path: Path, opened: Opened) -> Blocks:
    """Yield the blocks of a recording of samples; LogRefused if it is none."""
    observing = opened.observing
    if observing is None:
        raise LogRefused("a recording of samples needs --observers", str(path))
    drivers: list[Driver] = []
    watch = _Watch()

    def make(start_ns: int) -> Driver:
        drivers.append(
            Driver(
                [spec.make() for spec in observing.specs],
                start_ns,
                lenient=observing.lenient,
                on_problem=lambda problem: opened.problems.add(
                    f"{path}: {problem.where}", problem.message, bad=False
                ),
                listener=watch,
            )
        )
        return drivers[0]

    changes = Changes(opened.words(""))
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = _Lines(file)
        try:
            for change in replay(lines, make):
                yield from _begin(drivers, lines)
                restart_ns, watch.restart_ns = watch.restart_ns, None
                yield from changes.take([change], restart_ns)
        except (ValueError, KeyError, TypeError) as error:
            raise LogRefused(f"no recording: {error}", f"{path}:{lines.count}") from error
    opened.rows += lines.count
    if not drivers:
        raise LogRefused("an empty recording", str(path))
    yield from _begin(drivers, lines)
    yield from changes.rest()
    yield Block("", Advance(drivers[0].now_ns))
    if not lines.ended:
        opened.problems.add(f"{path}:{lines.count}", "ended early: the agent did not close it", bad=True)
        opened.ended_early = True


def _begin(drivers: list[Driver], lines: _Lines) -> Blocks:
    if not lines.begun:
        lines.begun = True
        yield Block("", Restart(lines.start_ns))


class _Lines:
    """The lines of a recording, as they are read."""

    def __init__(self, file: Iterator[str]) -> None:
        self._file = file
        self.count = 0
        self.start_ns = 0
        self.begun = False
        self.ended = False

    def __iter__(self) -> Iterator[str]:
        for line in self._file:
            self.count += 1
            if self.count == 1:
                self.start_ns = int(json.loads(line)["start"])
            self.ended = line.startswith('{"end"')
            yield line
