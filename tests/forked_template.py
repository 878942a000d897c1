"""The process from which programs of ours are forked: tests/forked.py.

It has loaded their code, has a single thread, and is asked over a socket: first the descriptors that the new
process is to have, then what it is to be, as JSON. It tells each one's number, and its end. Who runs tests
beside others asks for a template of its own.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import fcntl
import gc
import importlib
import json
import logging
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
import types
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

from tests.forked import ADDRESS, NUMBER, popen, use

CLIENT = ("robomend_client.agent.main", "robomend_client.agent.agent")
SERVICE = (
    "robomend.cli.main",
    "robomend.cli.serve",
    "robomend.api.runtime",
    "robomend.api.server",
    "uvloop",
    "robomend.cli.diagnose",
    "robomend.cli.plan",
    "robomend.cli.remote.status",
    "robomend.cli.remote.mcp",
    "robomend.diagnosis.sat",
    "robomend_board.main",
    "robomend_demo.command",
    "robomend_demo.run",
    "robomend_demo.devices",
)
"""What the template imports; nothing that starts a thread."""

STARTING = ("robomend.workers.process", "robomend.cli.stage")
"""Modules whose processes are forked in turn."""

MOST_DESCRIPTORS = 8
"""Of a process: its three streams, what is passed on, and what tells its end."""


def serve(control: socket.socket) -> None:
    """Fork whoever is asked for, and tell how each ends; when nobody can ask any more, all end."""
    wake, woken = os.pipe()
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serving = _Serving(control)
    while True:
        waited_for: list[int | socket.socket] = [wake, serving.listener, *serving.asking]
        ready, _, _ = select.select(waited_for, [], [])
        if wake in ready:
            os.read(wake, 1000)
        serving.reap()
        if serving.listener in ready:
            serving.asking.append(serving.listener.accept()[0])
        for asking in [one for one in serving.asking if one in ready]:
            asked, descriptors = _request(asking)
            if asked is None:
                if asking is control:
                    serving.end()
                    return
                serving.asking.remove(asking)
                asking.close()
            elif asked.get("listens"):  # it does, since before it answers
                asking.sendall(NUMBER.pack(serving.process))
            elif asked.get("template"):
                serving.divide(*descriptors)
            else:
                serving.fork(asked, descriptors)


def load() -> None:
    """Import what programs need."""
    there = find_spec("robomend") is not None  # the client is tested without the service
    for module in (*CLIENT, *(SERVICE if there else ())):
        importlib.import_module(module)
    _settle()


def load_planners() -> None:
    """Import what workers need."""
    importlib.import_module("robomend.planning.planner_pool").warm()
    logging.root.handlers.clear()  # a planner has logged: whoever is forked sets up its own log
    logging.root.setLevel(logging.WARNING)
    _settle()


def _settle() -> None:
    gc.collect()
    gc.freeze()  # or each process would copy what it only looks at
    assert threading.active_count() == 1


_needed = {load, load_planners}
"""What is still to be done; whoever is forked has what was done."""


def _have(wanted: Callable[[], None]) -> None:
    if wanted in _needed:
        wanted()
        _needed.remove(wanted)


class _Serving:
    """What the template knows of those who ask, and of those it has forked."""

    def __init__(self, control: socket.socket) -> None:
        self.asking = [control]
        self.process = os.getpid()
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(ADDRESS.format(self.process))
        self.listener.listen(64)
        self._ends: dict[int, int] = {}  # process -> where its end is told
        self._workers: dict[int, int] = {}  # process -> the one that it works for
        self._templates: set[int] = set()

    def reap(self) -> None:
        """Tell who has ended, and end who worked for them, as the kernel would."""
        while self._ends and (ended := os.waitpid(-1, os.WNOHANG))[0]:
            pid, status = ended
            end = self._ends.pop(pid)
            with contextlib.suppress(BrokenPipeError):  # nobody wants to know
                os.write(end, NUMBER.pack(os.waitstatus_to_exitcode(status)))
            os.close(end)
            self._workers.pop(pid, None)
            self._templates.discard(pid)
            for worker, by in self._workers.items():
                if by == pid:
                    os.kill(worker, signal.SIGKILL)

    def end(self) -> None:
        """Nobody needs anything any more."""
        for pid in self._ends.keys() - self._templates:  # those have to end what they forked
            os.kill(pid, signal.SIGKILL)

    def fork(self, asked: dict[str, Any], descriptors: list[int]) -> None:
        """Fork a process; `descriptors` are its own, and the last one tells its end."""
        _have(load)
        if asked["passed"]:
            _have(load_planners)
        pid = self._forked(descriptors)
        if not pid:
            _become(asked, descriptors, self.process)
        if asked["bound"]:
            self._workers[pid] = asked["by"]

    def divide(self, control: int, end: int) -> None:
        """Fork a template that is asked over `control`, for as long as somebody can."""
        _have(load)
        if find_spec("robomend") is not None:  # most of those who run service's tests need them in the end
            _have(load_planners)
        if pid := self._forked([control, end]):
            self._templates.add(pid)
            return
        try:
            os.setsid()  # whoever ends a test's processes by their group does not mean it
            for number in map(int, os.listdir("/proc/self/fd")):
                if number > 2 and number != control:
                    with contextlib.suppress(OSError):  # the list's own
                        os.close(number)
            serve(socket.socket(fileno=control))
        except BaseException:  # noqa: BLE001  # nothing above this is for the new process
            traceback.print_exc()
        finally:
            os._exit(0)

    def _forked(self, descriptors: list[int]) -> int:
        """Fork, and leave the new process, to which 0 is returned, all `descriptors` but the last."""
        end = descriptors.pop()
        if not (pid := os.fork()):
            for asking in (self.listener, *self.asking):
                asking.detach()
            return 0
        with contextlib.suppress(BrokenPipeError):  # whoever asked was killed meanwhile
            os.write(end, NUMBER.pack(pid))
        self._ends[pid] = end
        for descriptor in descriptors:
            os.close(descriptor)
        return pid


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


def _become(asked: dict[str, Any], descriptors: list[int], by: int) -> NoReturn:
    """Be the program that was asked for, until its end; `by`: the template."""
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
    _be_seen([sys.executable, *asked["command"]], asked["environment"])
    time.tzset()
    use(by)
    for starts in filter(None, map(sys.modules.get, STARTING)):
        vars(starts)["subprocess"] = types.SimpleNamespace(**{**vars(subprocess), "Popen": popen})
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
            sys.modules.pop(what, None)  # it is run, and not imported
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


def _be_seen(command: list[str], environment: dict[str, str]) -> None:
    """Write them where the kernel reads what it tells of a process: over those of the template."""
    text = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    begin, end, begin_environment, end_environment = map(int, text[45:49])
    own = sorted(environment, key=lambda name: name in _INHERITED)  # what is cut off is least likely missed
    settings = [f"{name}={environment[name]}" for name in own]
    for words, at, behind in ((command, begin, end), (settings, begin_environment, end_environment)):
        shown = b"".join(os.fsencode(word) + b"\0" for word in words)[: behind - at - 1]
        ctypes.memmove(at, shown.ljust(behind - at, b"\0"), behind - at)


_INHERITED = frozenset(os.environ)


if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as given:
        serve(given)
