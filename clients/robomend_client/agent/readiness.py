"""What counts as evidence that a process runs, so that nothing waits for a fixed time.

exec      the program was executed: true once `spawn` has returned
notify    it sent READY=1, the protocol of systemd's sd_notify(3): a datagram to the socket in NOTIFY_SOCKET
output    a line of its output matches
"""

from __future__ import annotations

import asyncio
import secrets
import socket


class Notification:
    """The socket for one start of one process: a random name in Linux's abstract namespace, gone with us."""

    def __init__(self, ready: asyncio.Event) -> None:
        self._ready = ready
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._name = f"robomend-notify-{secrets.token_hex(8)}"
        self._socket.bind(f"\0{self._name}")
        asyncio.get_running_loop().add_reader(self._socket, self._receive)

    @property
    def address(self) -> str:
        return f"@{self._name}"

    def _receive(self) -> None:
        try:
            datagram = self._socket.recv(4096)
        except OSError:
            return
        if b"READY=1" in datagram.split(b"\n"):
            self._ready.set()

    def close(self) -> None:
        if self._socket.fileno() >= 0:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
