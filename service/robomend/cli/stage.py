"""Processes that a command starts: told apart by their logs, and all gone at the end.

Each process leads a session of its own, so that Ctrl-C reaches the command alone, which then ends the others;
and each dies with the command (PR_SET_PDEATHSIG), so that kill -9 of that leaves nothing behind either.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import subprocess
import sys
import time
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from robomend.cli.interrupts import Interrupts
from robomend.errors import BackendError

PR_SET_PDEATHSIG = 1
GRACE_S = 4.0
"""For all processes to end by themselves after SIGTERM."""


class PartFailed(BackendError):
    """A part did not start, or did not come to its end."""

    code = "part-failed"


@dataclass(frozen=True, slots=True)
class Actor:
    """One running process."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    begins: int | None = None  # the end of a pipe, of one that waits for a line from it


class Stage:
    """Starts processes and, as a context manager, ends them all."""

    def __init__(self, folder: Path, environment: Mapping[str, str], interrupts: Interrupts) -> None:
        """`folder` takes their logs; it must exist."""
        self._folder = folder
        self._environment = dict(environment)
        self._interrupts = interrupts
        self._actors: list[Actor] = []

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.clear()

    def start(
        self, name: str, command: Sequence[str], *, announces: bool = False, waits: bool = False
    ) -> Actor:
        """Start a process; its output goes to `<name>.log`, but for the line that it `announces`.

        One that `waits` does so until it is told to begin.
        """
        self._interrupts.check()
        log = self._folder / f"{name}.log"
        parent = os.getpid()
        read, write = os.pipe() if waits else (subprocess.DEVNULL, None)
        with log.open("ab") as stream:
            process = subprocess.Popen(
                command,
                stdin=read,
                stdout=subprocess.PIPE if announces else stream,
                stderr=stream,
                env=self._environment,
                start_new_session=True,
                preexec_fn=lambda: die_with(parent),  # safe: no other thread of Python runs
            )
        if waits:
            os.close(read)
        actor = Actor(name, process, log, write)
        self._actors.append(actor)
        return actor

    def begin(self, actor: Actor) -> None:
        """Tell a process that waits to begin; one that has ended is found by `check`."""
        assert actor.begins is not None
        with contextlib.suppress(OSError):
            os.write(actor.begins, b"begin\n")

    def announced(self, actor: Actor, timeout_s: float) -> dict[str, Any]:
        """Wait for the one line of JSON that a process prints when it is ready (its ports, say).

        Raises:
            PartFailed: it ended, or the line did not come in time; with the end of its log.
        """
        pipe = actor.process.stdout
        assert pipe is not None
        line = b""
        deadline = time.monotonic() + timeout_s
        while not line.endswith(b"\n"):
            ready = self._interrupts.wait(deadline - time.monotonic(), pipe.fileno())
            chunk = os.read(pipe.fileno(), 1 << 16) if ready else b""
            if not chunk:
                why = f"was not ready within {timeout_s:g} s" if not ready else "ended before it was ready"
                raise PartFailed(f"{actor.name} {why}; its log ends:\n{tail(actor.log)}")
            line += chunk
        try:
            return dict(json.loads(line.splitlines()[0]))
        except ValueError as error:
            raise PartFailed(f"{actor.name} announced {line[:200]!r}, which is no JSON") from error

    def check(self, within_s: float = 0.0) -> None:
        """Raise PartFailed if any process has ended by itself, or does so `within_s` from now."""
        deadline = time.monotonic() + within_s
        self._check()
        while time.monotonic() < deadline:
            time.sleep(0.02)
            self._check()

    def _check(self) -> None:
        for actor in self._actors:
            status = actor.process.poll()
            if status is not None:
                how = f"was ended by signal {-status}" if status < 0 else f"ended with exit code {status}"
                raise PartFailed(f"{actor.name} {how} in the middle; its log ends:\n{tail(actor.log)}")

    def end(self, actor: Actor) -> None:
        """End one process, with what it started itself."""
        others = [one for one in self._actors if one is not actor]
        self._actors = [actor]
        self.clear()
        self._actors = others

    def clear(self) -> None:
        """End all processes, each with what it started itself."""
        for actor in reversed(self._actors):
            _signal_group(actor.process.pid, signal.SIGTERM)
        deadline = time.monotonic() + GRACE_S
        while self._actors:
            actor = self._actors[-1]
            with contextlib.suppress(subprocess.TimeoutExpired):
                actor.process.wait(max(0.0, deadline - time.monotonic()))
            _signal_group(actor.process.pid, signal.SIGKILL)  # whatever of its group is left
            actor.process.wait()
            if actor.process.stdout is not None:
                actor.process.stdout.close()
            if actor.begins is not None:
                os.close(actor.begins)
            self._actors.pop()


def python(module: str, *arguments: str) -> list[str]:
    """Return the command that runs one of our modules with this interpreter, wherever it is installed."""
    return [sys.executable, "-m", module, *arguments]


def environment() -> dict[str, str]:
    """Return the environment of all parts: ours, without settings that are meant for another service.

    ROBOMEND_DATABASE of a real installation must not make what is started write there. PYTHONSAFEPATH keeps
    files of the current folder from being taken for modules.
    """
    kept = {name: value for name, value in os.environ.items() if not name.startswith("ROBOMEND_")}
    return {**kept, "PYTHONSAFEPATH": "1", "PYTHONUNBUFFERED": "1"}


def show(address: str) -> None:
    """Open a page where there is a desktop: a browser in the terminal would take the picture's place."""
    if sys.platform == "darwin" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
        webbrowser.open(address)


_libc = ctypes.CDLL(None, use_errno=True)  # loaded here: the child between fork and exec must not import


def die_with(parent: int) -> None:
    """In a new child: ask the kernel for SIGTERM when the parent dies (Linux; elsewhere nothing happens)."""
    with contextlib.suppress(AttributeError):
        _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:  # it died before prctl: no signal will come
        os._exit(1)


def tail(log: Path) -> str:
    """Return the last lines of a log."""
    try:
        return "\n".join(log.read_text(errors="replace").splitlines()[-12:])
    except OSError as error:
        return f"(no log: {error.strerror})"


def _signal_group(pid: int, how: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, how)
