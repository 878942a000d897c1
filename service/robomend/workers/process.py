"""One worker process: the parent's end, and the program that it runs.

The program is a fresh interpreter, not a fork and not multiprocessing: no copied locks, no second import of
the caller's main module, no resource tracker left behind. The two ends talk over one socket, in pickles,
each after its length; only the parent holds the other end, so nobody else can speak on it.

No worker outlives its parent: the kernel kills it when the thread that started it ends (the pool starts all
from one thread that lives as long as it does), and where there is no such call a thread in the worker
watches the socket.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from typing import Any

from robomend.errors import SolverError, WorkerDied, WorkerNotReady
from robomend.starvation import waited_s
from robomend.workers.parent import die_with_parent

LENGTH = struct.Struct("<Q")
MAX_MESSAGE = 1 << 30  # bytes

EXCUSED_S = 540.0
"""So much of a slow start may be the computer's fault; after that it does not matter whose it is."""

OUT_OF_TIME = signal.SIGPROF
"""Ends a worker that has spent the processor time of its call: setitimer(2), ITIMER_PROF."""

READY, RESULT, ERROR = "ready", "result", "error"


class WorkerProcess:
    """One process, seen from the parent."""

    def __init__(self, start_with: bytes, niceness: int = 0) -> None:
        self.idle_since = time.monotonic()
        self._killing = threading.Lock()
        self._socket, theirs = socket.socketpair()
        with theirs:
            fd = theirs.fileno()
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-c",
                    _PROGRAM.format(path=sys.path, fd=fd, parent=os.getpid(), niceness=niceness),
                ],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(fd,),
                process_group=0,  # Ctrl-C goes to us, and killing the group ends what the worker started
            )
        self.pid = self._process.pid
        _send(self._socket, start_with)

    def wait_ready(self, timeout_s: float) -> None:
        """Wait until it is warm.

        Raises:
            WorkerNotReady: it is not; what others kept the processor from it does not count.
            WorkerDied: it ended.
            Exception: what warming it raised.
        """
        late = WorkerNotReady(f"no worker was ready within {timeout_s:g} s")
        began = time.monotonic()
        poll = select.poll()
        poll.register(self._socket, select.POLLIN)
        while not poll.poll(1000):
            if time.monotonic() - began > timeout_s + min(waited_s(self.pid), EXCUSED_S):
                raise late
        try:
            kind, value = self._receive(timeout_s)
        except TimeoutError:
            raise late from None
        except (EOFError, OSError) as error:
            raise WorkerDied(f"the worker process ended while starting ({self.ending()})") from error
        if kind != READY:
            raise value

    def alive(self) -> bool:
        """Whether it can take a call: idle workers send nothing, so a readable socket is a closed one."""
        poll = select.poll()
        poll.register(self._socket, select.POLLIN)
        return self._process.poll() is None and not poll.poll(0)

    def ask(self, request: bytes, timeout_s: float | None) -> tuple[str, Any]:
        """Send a call and return (kind, value). TimeoutError, EOFError or OSError when there is no answer."""
        self._socket.settimeout(timeout_s)
        _send(self._socket, request)
        return self._receive(timeout_s)

    def _receive(self, timeout_s: float | None) -> tuple[str, Any]:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        kind, value = pickle.loads(_receive(self._socket, deadline))
        return kind, value

    def kill(self) -> None:
        """End the process and everything in its group, and wait until it is gone. May be called twice."""
        with self._killing:
            if self._process.returncode is None:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(self.pid, signal.SIGKILL)
                self._process.kill()
                self._process.wait()
            # shutdown() wakes a thread that reads; close() alone would not.
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()

    def ending(self) -> str:
        """Return how the process ended, in words; ends it if it has not."""
        try:
            code = self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            return "its answer could not be read"
        if code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"exit code {code}"


_PROGRAM = (
    "import sys; sys.path[:] = {path!r}; from robomend.workers.process import serve; "
    "serve({fd}, {parent}, {niceness})"
)


def _send(connection: socket.socket, data: bytes) -> None:
    connection.sendall(LENGTH.pack(len(data)) + data)


def _receive(connection: socket.socket, deadline: float | None) -> bytes:
    (length,) = LENGTH.unpack(_receive_exactly(connection, LENGTH.size, deadline))
    if length > MAX_MESSAGE:
        raise EOFError(f"a message of {length} bytes")
    return _receive_exactly(connection, length, deadline)


def _receive_exactly(connection: socket.socket, count: int, deadline: float | None) -> bytes:
    data = bytearray()
    while len(data) < count:
        if deadline is not None:
            left = deadline - time.monotonic()
            if left <= 0:
                raise TimeoutError
            connection.settimeout(left)
        chunk = connection.recv(min(count - len(data), 1 << 20))
        if not chunk:
            raise EOFError("the other side is gone")
        data += chunk
    return bytes(data)


# --- in the worker process ---


def serve(fd: int, parent: int, niceness: int) -> None:
    """Answer calls until the parent is gone. Runs in the worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(OUT_OF_TIME, signal.SIG_DFL)
    os.nice(niceness)
    die_with_parent()
    if os.getppid() != parent:  # it ended before we asked
        os._exit(0)
    with socket.socket(fileno=fd) as connection:
        try:
            warm, memory_bytes = pickle.loads(_receive(connection, None))
            if memory_bytes is not None:
                _limit_memory(memory_bytes)
            if warm is not None:
                warm()
        except EOFError:
            return
        except BaseException as error:  # noqa: BLE001  # the parent is told, and ends us
            _answer(connection, ERROR, error)
            return
        _answer(connection, READY, None)
        requests: deque[bytes] = deque()
        arrived = threading.Semaphore(0)
        threading.Thread(target=_read, args=(connection, requests, arrived), daemon=True).start()
        while True:
            arrived.acquire()
            try:
                function, args, processor_s = pickle.loads(requests.popleft())
                signal.setitimer(
                    signal.ITIMER_PROF, processor_s or 0
                )  # in native code, too, the kernel ends us
                try:
                    result = function(*args)
                finally:
                    signal.setitimer(signal.ITIMER_PROF, 0)
            except BaseException as error:  # noqa: BLE001  # the caller gets it
                _answer(connection, ERROR, error)
            else:
                _answer(connection, RESULT, result)
            function = args = result = None  # free memory before the next call


def _read(connection: socket.socket, requests: deque[bytes], arrived: threading.Semaphore) -> None:
    """Take requests in; end the process when the parent is gone, also in the middle of a call."""
    while True:
        try:
            requests.append(_receive(connection, None))
        except (EOFError, OSError):
            os._exit(0)
        arrived.release()


def _answer(connection: socket.socket, kind: str, value: object) -> None:
    try:
        data = pickle.dumps((kind, value))
        if kind == ERROR:
            pickle.loads(data)  # some exceptions are written and cannot be read
    except Exception as error:  # noqa: BLE001  # anything that cannot travel is told in words
        what = value if kind == ERROR else error
        data = pickle.dumps((ERROR, SolverError(f"{type(what).__name__}: {what}")))
    _send(connection, data)


def _limit_memory(limit: int) -> None:
    try:
        resource = importlib.import_module("resource")
    except ImportError:  # not on this system
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    soft = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
