"""The demo as a subprocess, as a user starts it, and a look at what it leaves behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.clients.running_agent import alive
from tests.clients.service_double import eventually
from tests.forked import popen

END_S = 150.0  # more than the demo gives itself, so that it says what it waited for


@dataclass
class Playing:
    """A demo that runs, with a temporary folder of its own that its parts inherit."""

    process: subprocess.Popen[str]
    folder: Path

    @property
    def report(self) -> Path:
        return self.folder / "report"

    @property
    def scratch(self) -> list[Path]:
        """The demo's own temporary folders that are there now."""
        return list((self.folder / "tmp").glob("robomend-demo-*"))

    def said(self) -> str:
        """Return what it said on standard error so far."""
        return (self.folder / "said").read_text()

    def until_said(self, text: str) -> None:
        """Wait until it has said something."""
        eventually(lambda: text in self.said() or self.process.poll() is not None, f"{text!r}", END_S)
        assert text in self.said(), self.said()

    def parts(self) -> list[int]:
        """Return every live process that it started, directly or not."""
        mark = f"TMPDIR={self.folder / 'tmp'}".encode()
        return [
            pid for pid in _pids() if pid != self.process.pid and mark in _environment(pid) and alive(pid)
        ]

    def part(self, *words: str) -> int:
        """Return the process whose command line holds all words."""
        found = [pid for pid in self.parts() if all(word.encode() in _command(pid) for word in words)]
        assert len(found) == 1, (words, found)
        return found[0]

    def nothing_is_left(self) -> None:
        """No process, and no temporary folder."""
        eventually(lambda: not self.parts(), "no process is left")
        assert self.scratch == []


@contextmanager
def playing(
    folder: Path,
    *options: str,
    environment: Mapping[str, str] | None = None,
    start: Callable[..., Any] = subprocess.Popen,
) -> Iterator[Playing]:
    """Start a demo in a folder of its own; it is gone afterwards, whatever happened."""
    (folder / "tmp").mkdir(parents=True)
    with (folder / "said").open("w") as said, (folder / "out").open("w") as out:
        process = start(
            [sys.executable, "-m", "robomend", "demo", "--report", str(folder / "report"), *options],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=said,
            text=True,
            cwd=folder,
            env={**os.environ, "TMPDIR": str(folder / "tmp"), **(environment or {})},
        )
    demo = Playing(process, folder)
    try:
        yield demo
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait(END_S)
        eventually(lambda: not demo.parts(), "no process is left")


def play(folder: Path, *options: str, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Play to the end, with forked parts; return what `--format json` prints: all of standard output."""
    with playing(folder, "--format", "json", *options, environment=environment, start=popen) as demo:
        assert demo.process.wait(END_S) == 0, demo.said()
        demo.nothing_is_left()
    printed: dict[str, Any] = json.loads((folder / "out").read_text())
    return printed


def children(pid: int) -> list[int]:
    """Return the live processes that a process started."""
    return [child for child in _pids() if _parent(child) == pid and alive(child)]


def _parent(pid: int) -> int:
    stat = _read(Path(f"/proc/{pid}/stat")).decode(errors="replace")
    return int(stat.rpartition(")")[2].split()[1]) if stat else -1


def _pids() -> list[int]:
    return [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]


def _environment(pid: int) -> bytes:
    return _read(Path(f"/proc/{pid}/environ"))


def _command(pid: int) -> bytes:
    return _read(Path(f"/proc/{pid}/cmdline"))


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError:
        return b""
