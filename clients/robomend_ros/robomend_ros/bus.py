"""The agent's bus, from the side of who feeds it: lines of JSON over a stream socket."""

from __future__ import annotations

import json
import math
import socket
from typing import Callable, Mapping

LONGEST_LINE = 64 * 1024
WAIT_S = 1.0
AGAIN_S = 1.0


class Bus:
    """A connection to the agent that is made again when it is lost; what is said meanwhile is lost, too."""

    def __init__(self, address: str, clock: Callable[[], float]) -> None:
        """`address` is unix:PATH or tcp:HOST:PORT; `clock` gives seconds.

        Raises:
            ValueError: it is none of them.
        """
        kind, _, rest = address.partition(":")
        host, _, port = rest.rpartition(":")
        if not (rest if kind == "unix" else kind == "tcp" and host and port.isdigit()):
            raise ValueError(f"{address!r} is no address; write unix:PATH or tcp:HOST:PORT")
        self._path = rest if kind == "unix" else None
        self._host, self._port = host.strip("[]"), int(port) if port.isdigit() else 0
        self._clock = clock
        self._socket: socket.socket | None = None
        self._again_s = -math.inf

    def publish(
        self,
        topic: str,
        time_ns: int | None = None,
        data: object = None,
        fields: Mapping[str, object] | None = None,
    ) -> bool:
        """Say something; return whether the agent took it."""
        line = {"topic": topic, "time": time_ns, "data": data, "fields": fields}
        said = {key: value for key, value in line.items() if value is not None}
        text = json.dumps(said, separators=(",", ":")).encode() + b"\n"
        connection = self._connected() if len(text) <= LONGEST_LINE else None
        if connection is None:
            return False
        try:
            connection.sendall(text)
        except OSError:
            self.close()
            return False
        return True

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected(self) -> socket.socket | None:
        if self._socket is None and self._clock() >= self._again_s:
            self._again_s = self._clock() + AGAIN_S
            try:
                if self._path is not None:
                    found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                    found.settimeout(WAIT_S)
                    found.connect(self._path)
                else:
                    found = socket.create_connection((self._host, self._port), timeout=WAIT_S)
                self._socket = found
            except OSError:
                return None
        return self._socket
