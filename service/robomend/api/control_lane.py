"""A way of their own for stop, health and readiness: a thread that accepts, and answers these itself.

    the listening socket ──► control lane (a thread with an event loop of its own)
                                  │ looks at the first line, without taking it
               /stop, /healthz,   │            │ anything else
               /readyz ◄──────────┘            └──► the connection goes to the service's event loop, untouched
               answered here

So these answer while the service's event loop is held, or its database does not answer: the address is the
same, and clients need to know nothing. Such an answer ends its connection. A connection on which the
service's event loop has answered comes back to this lane; its next request finds its way by its first line.

Descriptors are kept for them: where connections are as many as this process may have, those that have been
silent for the longest end, here and in the service's event loop, so that there is always room for another.

Under TLS the first line cannot be seen before the handshake, and a connection for batches of observations
stays where it is. There, too, the stop waits for no disk and no key ring (see
robomend.repairs.stop_switch), but it waits for the loop's next turn.

Who asks for a stop is told (`UrgentAdmission`) without waiting for anything that may hang:

    the usual gate, on the service's event loop ── answers in time ──► its answer
                        │ the loop is held, or the database does not answer
                        └──► the keys and sign-ins as they were known last

A key that was revoked in a minute in which the database does not answer can still set a stop. The other way
round, a person at the red button would wait for a database. Who lifts a stop waits: it is lifted for nobody
who is only known from earlier.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import resource
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import cast

import structlog
import uvicorn
from starlette.requests import Request
from starlette.types import ASGIApp
from uvicorn.server import ServerState

from robomend.api.body import AGAIN
from robomend.api.gate import Admission
from robomend.api.problems import Problem
from robomend.api.protocol import Protocol, limited, make_room
from robomend.security import RULES, Principal
from robomend.settings import Settings

USUAL_S = 0.02
"""For the usual gate."""

UNKNOWN_S = 3.0
"""For a key that is not among those known last: it may be new."""


class UrgentAdmission:
    """See the module; stands in for `Admission` in another thread's event loop."""

    def __init__(self, usual: Admission, loop: asyncio.AbstractEventLoop) -> None:
        """`loop` is the event loop that the usual gate belongs to."""
        self.settings: Settings = usual.settings
        self._usual = usual
        self._loop = loop

    async def admit(self, request: Request, rule: tuple[str, str]) -> Principal:
        """Return who makes this request; raises as the usual gate does."""
        admitted = await self._admit(request, rule)
        request.scope[AGAIN] = partial(self.admit, rule=rule)  # in this loop, not in that of the usual gate
        return admitted

    async def _admit(self, request: Request, rule: tuple[str, str]) -> Principal:
        if RULES.get(rule) is None and rule in RULES:
            return await self._usual.let_in(request.scope, rule)  # needs no key, and so nothing to wait for
        if self._usual.ring.fresh and ("authorization" in request.headers or self._usual.ring.empty):
            known = self._usual.known(request, rule)
            if known is not None:
                return known
        asking = asyncio.run_coroutine_threadsafe(self._usual.let_in(request.scope, rule), self._loop)
        usual = asyncio.wrap_future(asking)
        await asyncio.wait({usual}, timeout=USUAL_S)
        if not usual.done():
            counts = rule[0] != "DELETE" or self._usual.ring.fresh
            known = self._usual.known(request, rule) if counts else None
            if known is not None:
                asking.cancel()
                return known
            await asyncio.wait({usual}, timeout=UNKNOWN_S)
        if not usual.done():
            asking.cancel()
            raise Problem(503, "the keys cannot be read now; try again")
        return usual.result()


log = structlog.get_logger("robomend.control")

FIRST_LINES = re.compile(rb"(?:(?:GET|POST|DELETE) /api/v1/stop|(?:GET|HEAD) /(?:healthz|readyz))[ ?]")
LONGEST = len(b"DELETE /api/v1/stop?")
BEGINNINGS = tuple(
    line
    for path, methods in (
        (b"/api/v1/stop", (b"GET", b"POST", b"DELETE")),
        (b"/healthz", (b"GET", b"HEAD")),
        (b"/readyz", (b"GET", b"HEAD")),
    )
    for line in (method + b" " + path for method in methods)
)

PART_S, PART_MOST_S = 0.01, 1.0
"""Between two looks at a first line that came in part; each is waited for twice as long as the one before."""

ACCEPTED = 64
"""Connections taken from the queue in a row."""

PAUSE_S = 0.1
"""Before trying again when none could be accepted: no descriptors are left, say."""

URGENT = -10
"""The thread's niceness, where the service may choose one (root, CAP_SYS_NICE)."""

HURRY_S = 0.0005
HURRIED_S = 0.2
"""How long the interpreter's lock is handed over so soon: for an answer, and the next one."""

JOIN_S = 5.0

KEPT_S = 30.0
"""A connection that has been answered may be silent for so long before its next request."""


OTHERS = 128
"""Descriptors that are no connections: the database's, those of workers, files, boards."""


def connections_allowed() -> int:
    """Return how many connections there may be, by what this process may have open."""
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if descriptors == resource.RLIM_INFINITY:
        descriptors = 1 << 20
    return max(64, descriptors - max(OTHERS, descriptors // 8))


def refuse(connection: socket.socket) -> None:
    """End a connection for which there is no room, and say so if it can be said at once."""
    log.warning("connection refused", why="there are as many as this process may have")
    answer = Problem(503, "there are as many connections as may be; try again").response()
    head = b"".join(b"%b: %b\r\n" % header for header in answer.raw_headers)
    text = b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\n%b\r\n" % head + bytes(answer.body)
    with contextlib.suppress(OSError):
        connection.send(text)
    connection.close()


class ControlLane:
    """See the module."""

    def __init__(
        self,
        app: ASGIApp,
        settings: Settings,
        listener: socket.socket,
        hand_over: Callable[[socket.socket], None],
        headers: Callable[[], list[tuple[bytes, bytes]]],
    ) -> None:
        """
        Args:
            app: answers what this lane keeps; see robomend.api.app.create_control_app.
            hand_over: takes every other connection; called in this lane's thread.
            headers: what each answer carries.
        """
        self._listener = listener
        self._hand_over = hand_over
        self._headers = headers
        self._timeout_s = settings.head_timeout_s
        self._peeks = not settings.tls_certificate
        self._state = ServerState()
        protocol = limited(settings.max_head_bytes, settings.head_timeout_s, once=True)
        self._config = uvicorn.Config(
            app,
            http=protocol,
            ws="none",
            lifespan="off",
            h11_max_incomplete_event_size=settings.max_head_bytes,
            log_config=None,
            access_log=False,
            server_header=False,
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        allowed = connections_allowed()  # half of them are the service's own
        self._most_quiet, self._most_answered = allowed // 4, allowed // 8
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="control-lane", daemon=True)
        self._usual_s = sys.getswitchinterval()
        self._hurrying: asyncio.TimerHandle | None = None
        self._quiet: dict[socket.socket, asyncio.TimerHandle] = {}  # connections that have said nothing yet
        self._answering: set[asyncio.Task[None]] = set()

    def start(self) -> None:
        """Begin to accept; returns when it does."""
        self._config.load()
        self._listener.setblocking(False)
        self._thread.start()
        self._ready.wait(JOIN_S)

    def take_back(self, connection: socket.socket) -> None:
        """Take a connection between two requests; for any thread."""
        try:
            if self._loop is None:
                raise RuntimeError("the lane has not begun")
            self._loop.call_soon_threadsafe(self._look, connection, KEPT_S)
        except RuntimeError:  # it has ended
            connection.close()

    def close(self) -> None:
        """Accept no more, and end the thread. Blocking, but not for long."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(JOIN_S)

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # where we may: on a busy machine this thread goes first
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), URGENT)
        # The standard library's loop: it lets us look at a socket that it then gives to a transport.
        with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
            self._loop = loop = runner.get_loop()
            loop.add_reader(self._listener, self._accept)
            self._ready.set()
            loop.run_forever()
            sys.setswitchinterval(self._usual_s)
            loop.remove_reader(self._listener)
            self._listener.close()
            for connection in (*self._quiet,):
                self._forget(connection)
                connection.close()

    def _accept(self) -> None:
        with self._soon():
            self._accept_all()

    def _accept_all(self) -> None:
        assert self._loop is not None
        for _ in range(ACCEPTED):
            try:
                connection, _ = self._listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                if error.errno in (errno.EMFILE, errno.ENFILE) and self._quiet:
                    self._give_up(next(iter(self._quiet)))
                    continue
                log.error("cannot accept", detail=str(error))
                self._loop.remove_reader(self._listener)
                self._loop.call_later(PAUSE_S, self._loop.add_reader, self._listener, self._accept)
                return
            connection.setblocking(False)
            if self._peeks:
                self._look(connection)
            else:
                self._hand_over(connection)

    def _wait(self, connection: socket.socket, timeout_s: float) -> None:
        """Look again when something has come."""
        assert self._loop is not None
        if connection not in self._quiet:
            if len(self._quiet) >= self._most_quiet:
                self._give_up(next(iter(self._quiet)))
            self._quiet[connection] = self._loop.call_later(timeout_s, self._give_up, connection)
            self._loop.add_reader(connection, self._look_soon, connection)

    def _forget(self, connection: socket.socket) -> None:
        assert self._loop is not None
        timer = self._quiet.pop(connection, None)
        if timer is not None:
            timer.cancel()
            self._loop.remove_reader(connection)

    def _give_up(self, connection: socket.socket) -> None:
        """It never said anything."""
        self._forget(connection)
        connection.close()

    def _look(
        self, connection: socket.socket, timeout_s: float | None = None, part_s: float = PART_S
    ) -> None:
        """Look at what a connection goes on with, and decide whose it is."""
        timeout_s = self._timeout_s if timeout_s is None else timeout_s
        assert self._loop is not None
        try:
            line = connection.recv(LONGEST, socket.MSG_PEEK)
        except (BlockingIOError, InterruptedError):
            self._wait(connection, timeout_s)
            return
        except OSError:
            line = b""
        if not line:  # gone again
            self._give_up(connection)
        elif FIRST_LINES.match(line):
            self._forget(connection)
            self._answer(connection)
        elif len(line) < LONGEST and any(whole.startswith(line) for whole in BEGINNINGS):
            # It may become one of ours. It stays readable, so the look is repeated by the clock.
            self._wait(connection, timeout_s)
            self._loop.remove_reader(connection)
            self._loop.call_later(part_s, self._look_again, connection, min(2 * part_s, PART_MOST_S))
        else:
            self._forget(connection)
            self._hand_over(connection)

    def _look_soon(self, connection: socket.socket) -> None:
        with self._soon():
            self._look(connection)

    def _look_again(self, connection: socket.socket, part_s: float) -> None:
        if connection in self._quiet:
            self._look(connection, part_s=part_s)

    def _answer(self, connection: socket.socket) -> None:
        """Give the connection to a protocol of this thread's loop."""
        assert self._loop is not None
        if not make_room(cast("set[Protocol]", self._state.connections), self._most_answered):
            refuse(connection)
            return
        self._hurry()
        self._state.default_headers = self._headers()

        async def connect() -> None:
            assert self._loop is not None
            try:
                await self._loop.connect_accepted_socket(self._protocol, connection)
            except OSError:
                connection.close()

        task = self._loop.create_task(connect())
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)

    @contextlib.contextmanager
    def _soon(self) -> Iterator[None]:
        """Have the interpreter's lock handed over sooner while it is not known whose a connection is.

        To accept it and to look at it takes the lock three times, each time behind all who want it.
        """
        sys.setswitchinterval(HURRY_S)
        try:
            yield
        finally:
            if self._hurrying is None:
                sys.setswitchinterval(self._usual_s)

    def _hurry(self) -> None:
        """Have it handed over sooner for a while.

        Whoever holds it keeps it for 5 ms, and an answer takes it a dozen times.
        """
        assert self._loop is not None
        sys.setswitchinterval(HURRY_S)
        if self._hurrying is not None:
            self._hurrying.cancel()
        self._hurrying = self._loop.call_later(HURRIED_S, self._calm)

    def _calm(self) -> None:
        self._hurrying = None
        sys.setswitchinterval(self._usual_s)

    def _protocol(self) -> asyncio.Protocol:
        protocol_class = self._config.http_protocol_class
        assert not isinstance(protocol_class, str)
        return protocol_class(  # type: ignore[call-arg]  # as uvicorn calls it
            config=self._config, server_state=self._state, app_state={}
        )
