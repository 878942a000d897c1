"""uvicorn behind the control lane: it says on which port it listens, and ends our streams before it waits.

An init system is told that requests are answered, and that the event loop turns (systemd's watchdog). A
process that hangs (SIGSTOP, a call that does not return) is replaced by systemd, where it is a unit of the
type `notify` with WatchdogSec. Elsewhere nobody is told anything.

Reference: sd_notify(3), sd_watchdog_enabled(3).
"""

from __future__ import annotations

import asyncio
import os
import shlex
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import cast

import structlog
import uvicorn

from robomend.api.app import create_control_app
from robomend.api.control_lane import ControlLane, UrgentAdmission, connections_allowed, refuse
from robomend.api.protocol import Protocol, limited, make_room
from robomend.api.runtime import Runtime
from robomend.errors import InputError
from robomend.security import loopback
from robomend.settings import Settings

SIGNS = 4
"""Of life in the time after which the watchdog takes us for dead."""


class InitSystem:
    """See the module; told of by the environment of a unit."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        watched = os.environ.get("WATCHDOG_USEC", "")
        ours = os.environ.get("WATCHDOG_PID", "") in ("", str(os.getpid()))
        self._every_s = int(watched) / 1e6 / SIGNS if ours and watched.isdigit() else None
        self._beating: asyncio.Task[None] | None = None

    def ready(self) -> None:
        """Say that requests are answered, and from now on that the running event loop turns."""
        self._say(b"READY=1")
        if self._address and self._every_s is not None:
            self._beating = asyncio.create_task(self._beat(self._every_s), name="watchdog")

    async def _beat(self, every_s: float) -> None:
        while True:
            self._say(b"WATCHDOG=1")
            await asyncio.sleep(every_s)

    def _say(self, what: bytes) -> None:
        if not self._address:
            return
        where = self._address.replace("@", "\0", 1) if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as line:
                line.sendto(what, where)
        except OSError as error:
            log.warning("the init system does not listen", detail=str(error))


def url_of(address: tuple[object, ...], *, secure: bool) -> str:
    """Return the URL that reaches a listening socket from this computer."""
    host, port = str(address[0]), address[1]
    if host in {"0.0.0.0", "::"}:
        host = "127.0.0.1" if host == "0.0.0.0" else "::1"
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if secure else 'http'}://{shown}:{port}"


log = structlog.get_logger("robomend.server")

SEND_BUFFER = 128 << 10
"""Bytes that the kernel takes for a client that does not read (it doubles the number).

Left to itself it takes megabytes, and each event would be handed to slow readers for minutes as if they kept
up. A second's worth of a busy fleet's events is enough for everybody else.
"""


class Server(uvicorn.Server):
    """uvicorn's server on connections that the control lane has accepted.

    An open event stream would block uvicorn's shutdown, so streams are ended first.
    """

    def __init__(self, config: uvicorn.Config, runtime: Runtime, ready: Callable[[str], None]) -> None:
        super().__init__(config)
        self._runtime = runtime
        self._ready = ready
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lane: ControlLane | None = None
        self._arriving: dict[asyncio.Task[None], None] = {}  # the oldest first
        self._handed = 0  # by the lane, and not yet looked at
        self._most = connections_allowed() // 2

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        self._loop = asyncio.get_running_loop()
        listener = listening_socket(self._runtime.settings)
        await super().startup([])  # nothing for uvicorn to accept on: connections come from the lane
        if not self.started:
            listener.close()
            return
        gate = UrgentAdmission(self._runtime.app.state.gate, self._loop)
        app = create_control_app(self._runtime.parts, gate)
        self._lane = ControlLane(app, self._runtime.settings, listener, self._take, self._headers)
        self._lane.start()
        self._ready(url_of(listener.getsockname(), secure=self.config.is_ssl))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        if self._lane is not None:
            await asyncio.to_thread(self._lane.close)
        await super().shutdown(sockets)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Listen to signals, and raise none again: an orderly end exits with 0."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {each: signal.signal(each, self.handle_exit) for each in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for each, handler in before.items():
                signal.signal(each, handler)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal came: the loop is told, since it may be asleep."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._runtime.end_waits)
        super().handle_exit(sig, frame)

    def _headers(self) -> list[tuple[bytes, bytes]]:
        return self.server_state.default_headers

    def _take(self, connection: socket.socket) -> None:
        """Take a connection from the lane, in whose thread this is called."""
        assert self._loop is not None
        try:
            if self._handed >= self._most // 4:  # they come faster than the loop can look which may stay
                refuse(connection)
            else:
                self._handed += 1
                self._loop.call_soon_threadsafe(self._connect, connection)
        except RuntimeError:  # the loop has ended
            connection.close()

    def _connect(self, connection: socket.socket) -> None:
        assert self._loop is not None
        self._handed -= 1
        if len(self._arriving) >= self._most // 4:  # handshakes of TLS that do not end
            next(iter(self._arriving)).cancel()
        connections = cast("set[Protocol]", self.server_state.connections)
        if not make_room(connections, self._most - len(self._arriving)):
            refuse(connection)
            return
        task = self._loop.create_task(self._adopt(connection))
        self._arriving[task] = None
        task.add_done_callback(self._arriving.pop)

    async def _adopt(self, connection: socket.socket) -> None:
        assert self._loop is not None
        try:
            await self._loop.connect_accepted_socket(self._protocol, connection, ssl=self.config.ssl)
        except OSError as error:  # gone again, or no TLS
            log.debug("connection not taken", detail=str(error))
            connection.close()

    def _protocol(self) -> asyncio.Protocol:
        protocol_class = self.config.http_protocol_class
        assert not isinstance(protocol_class, str)
        made = protocol_class(  # type: ignore[call-arg]  # as uvicorn calls it
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )
        if isinstance(made, Protocol) and self._lane is not None and not self.config.is_ssl:
            made.give_back = self._lane.take_back
        return made


def listening_socket(settings: Settings) -> socket.socket:
    """Return the socket that the service listens on."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # The connections that it accepts inherit it.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    try:
        listener.bind((settings.host, settings.port))
    except OSError as error:
        listener.close()
        where = f"{settings.host}:{settings.port}"
        raise InputError(f"cannot listen on {where}: {error.strerror}; is another service there?") from error
    listener.listen(2048)
    return listener


def make_server(runtime: Runtime, ready: Callable[[str], None]) -> Server:
    """Return a server for the settings; `ready` is called with its URL once it listens."""
    settings = runtime.settings
    config = uvicorn.Config(
        runtime.app.state.edge,
        http=limited(settings.max_head_bytes, settings.head_timeout_s),
        h11_max_incomplete_event_size=settings.max_head_bytes,
        loop="auto",
        ws="none",
        lifespan="on",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=round(settings.graceful_s),
        ssl_certfile=settings.tls_certificate,
        ssl_keyfile=settings.tls_key,
    )
    return Server(config, runtime, ready)


def check_exposure(settings: Settings, any_key: bool) -> None:
    """Refuse to listen where others reach us while nobody needs a key."""
    if not loopback(settings.host) and not any_key:
        where = f"--data {shlex.quote(str(settings.data))}"
        if settings.database is not None:  # its URL may hold a password
            where = "and the --database of this service"
        raise InputError(
            f"host {settings.host!r} is reachable from other computers, and there is no key yet: "
            f"create one with `robomend keys create --role admin {where}`, or listen on 127.0.0.1"
        )
    if (settings.tls_certificate is None) != (settings.tls_key is None):
        raise InputError("tls_certificate and tls_key go together: give both or neither")
