"""Programs of ours as real processes that need not load their code: forked from a template that has.

To import the service takes a second of processor time, and the tests start it a hundred times. The template
imports it once, has a single thread, and forks whoever is asked for: each with arguments, environment, folder
and output of its own, and its own end. How a program starts is tested with fresh interpreters, in
tests/api/test_process.py; what a test puts on PYTHONPATH, and lines that coverage counts, need one as well.

The workers of a service (robomend.workers) are such programs, too: to load the planners takes seconds, and
each service begins with a worker that few tests need. tests/workers/ has fresh ones.

    process = popen([sys.executable, "-m", "robomend", "serve", …], stdout=subprocess.PIPE, text=True)
"""

from __future__ import annotations

import array
import atexit
import contextlib
import fcntl
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import traceback
import types
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    import pytest  # which the template need not load

LOADED = ("robomend.cli.main", "robomend.cli.serve", "robomend.api.runtime", "robomend.api.server", "uvloop")
"""What the template imports; nothing that starts a thread."""

NUMBER = struct.Struct("<i")
ROOT = Path(__file__).parents[1]

WORDS = {"stdin", "stdout", "stderr", "text", "cwd", "env", "start_new_session", "pass_fds", "process_group"}
"""The options of subprocess.Popen that are understood."""

MOST_DESCRIPTORS = 8
"""Of a process: its three streams, what is passed on, and what tells its end."""


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
    if not alike or counted or environment.get("PYTHONPATH") != _TEMPLATE.path:
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
        self.path = os.environ.get("PYTHONPATH")
        self._address = address
        self._socket: socket.socket | None = None
        self._lock = threading.Lock()

    def fork(self, asked: dict[str, Any], *descriptors: int) -> tuple[int, int]:
        """Return the new process, and what tells its end."""
        ends, theirs = os.pipe()
        with self._lock:
            if self._socket is None:
                self._start()
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

    def _start(self) -> None:
        if self._address is not None:
            self._socket = socket.socket(socket.AF_UNIX)
            self._socket.connect(self._address)
            return
        self._socket, theirs = socket.socketpair()
        with theirs:
            subprocess.Popen(
                [sys.executable, "-m", "tests.forked", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                cwd=ROOT,  # wherever the test is that needs it first
                start_new_session=True,  # whoever ends a test's processes by their group does not mean it
            )


_TEMPLATE = _Template()


# --- in the template ---


def serve(control: socket.socket) -> None:
    """Fork whoever is asked for, and tell how each ends; when nobody can ask any more, all end."""
    for module in LOADED:
        importlib.import_module(module)
    gc.collect()
    gc.freeze()  # or each process would copy what it only looks at
    assert threading.active_count() == 1
    wake, woken = os.pipe()
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    template = _Serving(control)
    while True:
        waited_for: list[int | socket.socket] = [wake, template.listener, *template.asking]
        ready, _, _ = select.select(waited_for, [], [])
        if wake in ready:
            os.read(wake, 1000)
        template.reap()
        if template.listener in ready:
            template.asking.append(template.listener.accept()[0])
        for asking in [one for one in template.asking if one in ready]:
            asked, descriptors = _request(asking)
            if asked is None:
                if asking is control:
                    template.end()
                    return
                template.asking.remove(asking)
                asking.close()
            else:
                template.fork(asked, descriptors)


class _Serving:
    """What the template knows of those who ask, and of those it has forked."""

    def __init__(self, control: socket.socket) -> None:
        self.asking = [control]
        self.address = f"\0robomend-tests-{os.getpid()}"  # in no folder: processes that it forked ask there
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(self.address)
        self.listener.listen(64)
        self._ends: dict[int, int] = {}  # process -> where its end is told
        self._workers: dict[int, int] = {}  # process -> the one that it works for
        self._warm = False

    def reap(self) -> None:
        """Tell who has ended, and end who worked for them, as the kernel would."""
        while self._ends and (ended := os.waitpid(-1, os.WNOHANG))[0]:
            pid, status = ended
            end = self._ends.pop(pid)
            with contextlib.suppress(BrokenPipeError):  # nobody wants to know
                os.write(end, NUMBER.pack(os.waitstatus_to_exitcode(status)))
            os.close(end)
            self._workers.pop(pid, None)
            for worker, by in self._workers.items():
                if by == pid:
                    os.kill(worker, signal.SIGKILL)

    def end(self) -> None:
        """Nobody needs anything any more."""
        for pid in self._ends:
            os.kill(pid, signal.SIGKILL)

    def fork(self, asked: dict[str, Any], descriptors: list[int]) -> None:
        """Fork a process; `descriptors` are its own, and the last one tells its end."""
        if asked["passed"] and not self._warm:
            importlib.import_module("robomend.planning.planner_pool").warm()
            gc.freeze()
            assert threading.active_count() == 1
            self._warm = True
        pid = os.fork()
        if not pid:
            for asking in (self.listener, *self.asking):
                asking.detach()
            _become(asked, descriptors[:-1], self.address)
        with contextlib.suppress(BrokenPipeError):  # whoever asked was killed meanwhile
            os.write(descriptors[-1], NUMBER.pack(pid))
        self._ends[pid] = descriptors.pop()
        if asked["passed"]:
            self._workers[pid] = asked["by"]
        for descriptor in descriptors:
            os.close(descriptor)


def _request(asking: socket.socket) -> tuple[dict[str, Any] | None, list[int]]:
    """Return what is asked, and the descriptors with it; None: nobody asks any more."""
    head, descriptors, _, _ = socket.recv_fds(asking, NUMBER.size, MOST_DESCRIPTORS)
    text = b""
    while head and len(text) < NUMBER.unpack(head)[0]:
        more = asking.recv(NUMBER.unpack(head)[0] - len(text))
        if not more:  # killed in the middle of asking
            break
        text += more
    if head and text:
        with contextlib.suppress(json.JSONDecodeError):
            return json.loads(text), descriptors
    for descriptor in descriptors:
        os.close(descriptor)
    return None, []


def _become(asked: dict[str, Any], descriptors: list[int], template: str) -> NoReturn:
    """Be the program that was asked for, until its end."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if asked["session"]:
        os.setsid()
    if asked["group"]:
        os.setpgid(0, 0)
    numbers = (0, 1, 2, *asked["passed"])
    aside = [fcntl.fcntl(number, fcntl.F_DUPFD, max(numbers) + 1) for number in descriptors]
    for number, descriptor in zip(numbers, aside, strict=True):
        os.dup2(descriptor, number)
    for number in map(int, os.listdir("/proc/self/fd")):
        if number not in numbers:
            with contextlib.suppress(OSError):  # the list's own
                os.close(number)
    os.chdir(asked["folder"])
    os.environ.clear()
    os.environ.update(asked["environment"])
    time.tzset()
    global _TEMPLATE
    _TEMPLATE = _Template(template)
    workers = importlib.import_module("robomend.workers.process")
    vars(workers)["subprocess"] = types.SimpleNamespace(**{**vars(subprocess), "Popen": popen})
    if asked["passed"]:  # a worker looks whether whoever asked for it is its parent; `reap` sees to that
        vars(os)["getppid"] = lambda: asked["by"]
    sys.stdin, sys.stdout, sys.stderr = (
        os.fdopen(number, how, closefd=False, buffering=1) for number, how in enumerate("rww")
    )
    code = 0
    try:
        kind, what, *arguments = asked["command"]
        sys.argv = [kind, *arguments]
        if kind == "-m":
            runpy.run_module(what, run_name="__main__", alter_sys=True)
        else:
            sys.modules["__main__"] = main = types.ModuleType("__main__")
            exec(compile(what, "<string>", "exec"), main.__dict__)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1 if end.code else 0
        if isinstance(end.code, str):
            sys.stderr.write(f"{end.code}\n")
    except BaseException:  # noqa: BLE001  # as the interpreter does
        traceback.print_exc()
        code = 1
    try:
        threading._shutdown()  # type: ignore[attr-defined]  # as the interpreter does, as what follows
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code & 0xFF)


if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as given:
        serve(given)
