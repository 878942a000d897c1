"""uvicorn, told to end our streams before it waits for them, and to say on which port it listens."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from types import FrameType

import uvicorn

from robomend.api.address import url_of
from robomend.api.protocol import limited
from robomend.api.runtime import Runtime
from robomend.errors import InputError
from robomend.security import loopback
from robomend.settings import Settings

SEND_BUFFER = 128 << 10
"""Bytes that the kernel takes for a client that does not read (it doubles the number).

Left to itself it takes megabytes, and each event would be handed to slow readers for minutes as if they kept
up. A second's worth of a busy fleet's events is enough for everybody else.
"""


class Server(uvicorn.Server):
    """An open event stream would block uvicorn's shutdown, so streams are ended first."""

    def __init__(self, config: uvicorn.Config, runtime: Runtime, ready: Callable[[str], None]) -> None:
        super().__init__(config)
        self._runtime = runtime
        self._ready = ready
        self._loop: asyncio.AbstractEventLoop | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        self._loop = asyncio.get_running_loop()
        await super().startup(sockets)
        if self.started:
            listening = sockets or self.servers[0].sockets
            for listener in listening:  # the connections that it accepts inherit it
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            self._ready(url_of(listening[0].getsockname(), secure=self.config.is_ssl))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await super().shutdown(sockets)
        self._captured_signals.clear()  # an orderly end is no death by signal: the exit code is 0

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal came: the loop is told, since it may be asleep."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._runtime.end_waits)
        super().handle_exit(sig, frame)


def make_server(runtime: Runtime, ready: Callable[[str], None]) -> Server:
    """Return a server for the settings; `ready` is called with its URL once it listens."""
    settings = runtime.settings
    config = uvicorn.Config(
        runtime.app,
        host=settings.host,
        port=settings.port,
        http=limited(settings.max_head_bytes, settings.head_timeout_s),
        loop="auto",
        ws="none",
        lifespan="on",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=round(settings.graceful_s),
        backlog=2048,
        ssl_certfile=settings.tls_certificate,
        ssl_keyfile=settings.tls_key,
    )
    return Server(config, runtime, ready)


def check_exposure(settings: Settings, any_key: bool) -> None:
    """Refuse to listen where others reach us while nobody needs a key."""
    if not loopback(settings.host) and not any_key:
        raise InputError(
            f"host {settings.host!r} is reachable from other computers, and there is no key yet: "
            "create one with `robomend keys create --role admin`, or listen on 127.0.0.1"
        )
    if (settings.tls_certificate is None) != (settings.tls_key is None):
        raise InputError("tls_certificate and tls_key go together: give both or neither")
