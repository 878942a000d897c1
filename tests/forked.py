"""Programs of ours as real processes that need not load their code: forked from a template that has.

To import the service takes a second of processor time, and the tests start it a hundred times. The template
imports it once, has a single thread, and forks whoever is asked for: each with arguments, environment, folder
and output of its own, its own end, and a command line that others see. How a program starts is tested with
fresh interpreters, in tests/api/test_process.py; what a test puts on PYTHONPATH or loads before the C library
needs one as well, and so do lines that coverage counts.

The workers of a service (robomend.workers) are such programs, too: to load the planners takes seconds, and
each service begins with a worker that few tests need. tests/workers/ has fresh ones.

Each of xdist's workers has a template of its own, which is forked in turn: from one that all of them share
and that loads the code when the first of them needs it.

    process = popen([sys.executable, "-m", "robomend", "serve", …], stdout=subprocess.PIPE, text=True)
"""

from __future__ import annotations

import array
import contextlib
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import types
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pytest  # which the template need not load

NUMBER = struct.Struct("<i")
ROOT = Path(__file__).parents[1]

WORDS = {
    "stdin",
    "stdout",
    "stderr",
    "text",
    "cwd",
    "env",
    "start_new_session",
    "pass_fds",
    "process_group",
    "preexec_fn",
}
"""The options of subprocess.Popen that are understood; ours calls `preexec_fn` to end with who started it."""

ADDRESS = "\0robomend-tests-{}"
"""Of a template, by its process, in no folder: what it forked asks there."""

SHOWN_BYTES = 8_000
"""For the command line of a process, and as many for its environment."""


class Forked:
    """A process, with as much of subprocess.Popen as tests use."""

    def __init__(self, pid: int, ends: int, stdout: IO[Any] | None) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self.stdout = stdout
        self._ends = ends
        self._lock = threading.Lock()  # the pool of workers looks from several threads

    def __del__(self) -> None:
        os.close(self._ends)

    def poll(self) -> int | None:
        """Return how it ended: the exit code, or minus the signal; None: it runs."""
        return self._look(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end, and return what `poll` does.

        Raises:
            subprocess.TimeoutExpired: it runs on.
        """
        if (code := self._look(timeout)) is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return code

    def _look(self, timeout_s: float | None) -> int | None:
        if self.returncode is None and select.select([self._ends], [], [], timeout_s)[0]:
            with self._lock:
                if self.returncode is None:
                    told = os.read(self._ends, NUMBER.size)
                    self.returncode = NUMBER.unpack(told)[0] if told else -signal.SIGKILL
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):  # it has ended, and the template is about to say so
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)


def popen(command: list[str], **options: Any) -> Any:
    """Start a program as subprocess.Popen does: from the template, if it is Python on the usual path."""
    environment = dict(options.get("env") or os.environ)
    alike = command[0] == sys.executable and command[1] in ("-c", "-m") and options.keys() <= WORDS
    counted = any(name.startswith("COVERAGE_PROCESS") for name in environment)
    loaded = any(environment.get(name) != value for name, value in _TEMPLATE.loaded.items())
    if not alike or counted or loaded:
        return subprocess.Popen(command, **options)
    piped = options.get("stdout") == subprocess.PIPE
    read, write = os.pipe() if piped else (-1, -1)
    streams: list[IO[Any]] = []

    def descriptor(name: str, default: int) -> int:
        wanted = options.get(name)
        if wanted is None:
            return default
        if wanted == subprocess.DEVNULL:
            streams.append(open(os.devnull, "r+b"))  # noqa: SIM115  # closed below, with the others
            return streams[-1].fileno()
        if wanted == subprocess.PIPE:
            return write
        return wanted if isinstance(wanted, int) else int(wanted.fileno())

    out = descriptor("stdout", 1)
    error = out if options.get("stderr") == subprocess.STDOUT else descriptor("stderr", 2)
    passed = [int(number) for number in options.get("pass_fds", ())]
    asked = {
        "command": [str(word) for word in command[1:]],
        "folder": str(options.get("cwd") or os.getcwd()),
        "environment": environment,
        "session": bool(options.get("start_new_session")),
        "group": options.get("process_group") == 0,
        "passed": passed,
        "bound": bool(passed) or options.get("preexec_fn") is not None,
        "by": os.getpid(),
    }
    try:
        pid, ends = _TEMPLATE.fork(asked, descriptor("stdin", 0), out, error, *passed)
    finally:
        for stream in streams:
            stream.close()
        if piped:
            os.close(write)
    return Forked(pid, ends, (os.fdopen(read, "r" if options.get("text") else "rb") if piped else None))


def at_once(monkeypatch: pytest.MonkeyPatch, module: types.ModuleType) -> None:
    """Let a module of ours that starts programs start them so."""
    monkeypatch.setattr(module, "subprocess", types.SimpleNamespace(**{**vars(subprocess), "Popen": popen}))


class _Template:
    """The template, from outside; started when it is first needed, unless it is there: at an address."""

    def __init__(self, address: str | None = None) -> None:
        self.loaded = {name: os.environ.get(name) for name in ("PYTHONPATH", "LD_PRELOAD")}
        self.process = 0
        self.shared = 0
        """The template from which this one is forked; 0: it is a process of its own."""
        self._address = address
        self._socket: socket.socket | None = None
        self._lock = threading.Lock()

    def fork(self, asked: dict[str, Any], *descriptors: int) -> tuple[int, int]:
        """Return the new process, and what tells its end."""
        ends, theirs = os.pipe()
        with self._lock:
            self.start()
            assert self._socket is not None
            text = json.dumps(asked).encode()
            rights = array.array("i", [*descriptors, theirs])
            self._socket.sendmsg([NUMBER.pack(len(text))], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, rights)])
            self._socket.sendall(text)
        os.close(theirs)
        told = os.read(ends, NUMBER.size)
        if not told:
            self._socket = None  # the next one who needs it starts another
            raise AssertionError("the template is gone")
        return NUMBER.unpack(told)[0], ends

    def listens(self) -> None:
        """Wait until others can ask it, too."""
        assert self._socket is not None
        text = json.dumps({"listens": True}).encode()
        self._socket.sendall(NUMBER.pack(len(text)) + text)
        assert self._socket.recv(NUMBER.size), "the template did not start"

    def start(self) -> None:
        """Have it there, unless it is."""
        if self._socket is not None:
            return
        if self._address is not None:
            self._socket = socket.socket(socket.AF_UNIX)
            self._socket.connect(self._address)
            return
        self._socket, theirs = socket.socketpair()
        with theirs:
            if self.shared:
                asked = {"template": True}
                self.process, ends = _Template(ADDRESS.format(self.shared)).fork(asked, theirs.fileno())
                os.close(ends)
                return
            process = subprocess.Popen(
                [sys.executable, "-m", "tests.forked_template", str(theirs.fileno()), " " * SHOWN_BYTES],
                env={**os.environ, "ROOM": " " * SHOWN_BYTES},
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                cwd=ROOT,  # wherever the test is that needs it first
                start_new_session=True,  # whoever ends a test's processes by their group does not mean it
            )
        self.process = process.pid


_TEMPLATE = _Template()


def template() -> int:
    """Return the template's process, which is there now."""
    if not _TEMPLATE.process:
        popen([sys.executable, "-c", ""]).wait()
    return _TEMPLATE.process


def use(process: int) -> None:
    """Have that template fork what this process starts."""
    global _TEMPLATE
    _TEMPLATE = _Template(ADDRESS.format(process))


def share() -> int:
    """Return the process of a template for those who run tests side by side: it ends with this process."""
    if not _TEMPLATE.process:
        _TEMPLATE.start()
        _TEMPLATE.listens()
    return _TEMPLATE.process


def shared(process: int) -> None:
    """Have the template of this process forked from the one that others use, too, once it is needed."""
    _TEMPLATE.shared = process


def aside() -> list[int]:
    """Return who works for this process and is not below it: its template, if that was forked."""
    return [_TEMPLATE.process] if _TEMPLATE.shared and _TEMPLATE.process else []
