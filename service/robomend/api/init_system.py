"""Tells an init system that requests are answered, and that the event loop turns: systemd's watchdog.

A process that hangs (SIGSTOP, a call that does not return) is replaced by systemd, where it is a unit of the
type `notify` with WatchdogSec. Elsewhere nobody is told anything.

Reference: sd_notify(3), sd_watchdog_enabled(3).
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Mapping

import structlog

log = structlog.get_logger("robomend.init_system")

SIGNS = 4
"""Of life in the time after which the watchdog takes us for dead."""


class InitSystem:
    """See the module; told of by the environment of a unit."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        watched = environment.get("WATCHDOG_USEC", "")
        ours = environment.get("WATCHDOG_PID", "") in ("", str(os.getpid()))
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
