"""`robomend serve --workers N`: N service processes on one listening socket and one database.

    parent: binds the socket ──► starts N children, each a whole service on the inherited socket
               │                        │ a socket pair each:  child says `ready` ──► parent announces once
               │                        └─ the parent is gone: the kernel kills the child; where it does not,
               │                           the end of file does
               ├─ a child died ──► another in its place      SIGTERM ──► to each child, each ends in order
               └─ a child's event loop has said nothing for a while (SIGSTOP, a call that does not return):
                  killed, and so replaced; what it held (SQLite's lock, its robots) is free again

The children are instances like those on several machines: they share the work through the database, and when
one dies the others take its robots over (docs/storage.md). The parent holds no state, so that nothing is lost
with it; its death ends the children at once, since nobody would replace them any more.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import sys
import threading
from asyncio.subprocess import Process
from collections.abc import Callable, Sequence

import structlog

from robomend.errors import InputError
from robomend.figures import shared_file
from robomend.settings import Settings
from robomend.starvation import OwnSilence, waited_s
from robomend.workers.parent import die_with_parent

log = structlog.get_logger("robomend.api.supervising")

READY = b"R"
BEAT = b"B"
BEAT_S = 0.3
"""Between two signs of a child."""
LOOK_S = 0.5
HANGS_S = 3.5
"""Silence of a child, by its own doing (robomend.starvation), after which it is killed."""
BACK_OFF_S = 1.0
"""Between a child's death and its successor, where it died before it was ready."""
FAILURES = 5
"""Children in a row that die before they are ready, after which the parent gives up."""
BEYOND_S = 5.0
"""Beyond the graceful time, before a child that does not end is killed."""
PARENT_GONE = 70
"""The exit code of a child without a parent; nobody is there to read it."""


def listening_socket(settings: Settings) -> socket.socket:
    """Return the socket that all children serve."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((settings.host, settings.port))
    except OSError as error:
        listener.close()
        where = f"{settings.host}:{settings.port}"
        raise InputError(f"cannot listen on {where}: {error.strerror}; is another service there?") from error
    listener.listen(2048)
    return listener


class WorkerSupervisor:
    """See the module. Belongs to one event loop."""

    def __init__(
        self, settings: Settings, listener: socket.socket, arguments: Sequence[str], ready: Callable[[], None]
    ) -> None:
        """`arguments` are those of `robomend serve`; `ready` is called once, when every child serves."""
        self._settings = settings
        self._listener = listener
        self._arguments = list(arguments)
        self._ready = ready
        self._unready = settings.workers
        self._failures = 0
        self._code = 0
        self._children: set[Process] = set()
        self._figures = shared_file()
        self._ending = asyncio.Event()

    async def run(self) -> int:
        """Keep N children alive until a signal comes or they cannot start; return the exit code."""
        loop = asyncio.get_running_loop()
        for each in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(each, self._ending.set)
        places = [asyncio.create_task(self._keep(number)) for number in range(self._settings.workers)]
        await self._ending.wait()
        for child in self._children:
            child.terminate()
        _, late = await asyncio.wait(places, timeout=self._settings.graceful_s + BEYOND_S)
        for child in tuple(self._children):
            log.warning("killed a worker that did not end", pid=child.pid)
            child.kill()
        if late:
            await asyncio.wait(late)
        return self._code

    async def _keep(self, number: int) -> None:
        """Have a child in this place until the end."""
        first = True
        while not self._ending.is_set():
            ours, theirs = socket.socketpair()
            with ours, theirs:
                ours.setblocking(False)
                child = await self._start(theirs, number)
                theirs.close()
                self._children.add(child)
                if self._ending.is_set():  # the signal came while it started, and did not reach it
                    child.terminate()
                serves = await asyncio.get_running_loop().sock_recv(ours, 1) == READY
                if serves:
                    self._failures = 0
                    if first:
                        first = False
                        self._one_more()
                code = await self._wait(child, ours, number)
                self._children.discard(child)
            if self._ending.is_set():
                return
            log.error("worker ended", number=number, pid=child.pid, code=code)
            if not serves:
                self._failures += 1
                if code == 2 or self._failures >= FAILURES:  # bad input stays bad
                    self._code = code if code > 0 else 3
                    self._ending.set()
                    return
                await asyncio.sleep(BACK_OFF_S)

    async def _wait(self, child: Process, line: socket.socket, number: int) -> int:
        """Return the exit code of a child; one that hangs is killed."""
        ending = asyncio.create_task(child.wait())
        now_s = 0.0  # counted in looks: a supervisor that was asleep itself has heard nothing of anybody
        silence = OwnSilence(now_s, waited_s(child.pid))
        while True:
            await asyncio.wait({ending}, timeout=LOOK_S)
            if ending.done():
                return ending.result()
            now_s += LOOK_S
            waited = waited_s(child.pid)
            if _heard(line):
                silence = OwnSilence(now_s, waited)
            elif silence.lasts_s(now_s, waited) >= HANGS_S and not self._ending.is_set():
                log.error("worker hangs, and is killed", number=number, pid=child.pid)
                child.kill()
                return await ending

    async def _start(self, theirs: socket.socket, number: int) -> Process:
        descriptors = (self._listener.fileno(), theirs.fileno(), self._figures)
        names = ("--listen-fd", "--parent-fd", "--figures-fd")
        inherited = [text for name, fd in zip(names, descriptors, strict=True) for text in (name, str(fd))]
        inherited += ["--place", str(number)]
        program = [sys.executable, "-m", "robomend", *self._arguments, *inherited]
        return await asyncio.create_subprocess_exec(*program, pass_fds=descriptors)

    def _one_more(self) -> None:
        self._unready -= 1
        if self._unready == 0:
            self._ready()


def _heard(line: socket.socket) -> bool:
    """Return whether something came over this line."""
    try:
        return bool(line.recv(4096))
    except OSError:  # nothing came, or nobody is there any more
        return False


class Parent:
    """The child's end of the line to its parent."""

    def __init__(self, descriptor: int) -> None:
        self._line = socket.socket(fileno=descriptor)
        self._line.setblocking(True)
        os.set_inheritable(descriptor, False)  # a solver's process must not keep it open

    def watch(self) -> None:
        """End this process as soon as the parent is gone. What was acknowledged is on disk."""
        die_with_parent()
        threading.Thread(target=self._wait, name="parent", daemon=True).start()

    def ready(self) -> None:
        """Tell the parent that this child serves."""
        self._line.sendall(READY)

    async def beat(self) -> None:
        """Tell the parent, for ever, that the event loop turns."""
        while True:
            with contextlib.suppress(OSError):  # the parent reads nothing; that is not our fault
                self._line.send(BEAT, socket.MSG_DONTWAIT)
            await asyncio.sleep(BEAT_S)

    def _wait(self) -> None:
        try:
            while self._line.recv(1):
                pass
        except OSError:
            pass
        os._exit(PARENT_GONE)
