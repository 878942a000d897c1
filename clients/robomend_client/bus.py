"""The local bus: how the processes of one robot pass messages on when there is no ROS.
This is a node's side of it.

Lines of JSON over one stream socket to the broker, which runs inside the agent
(robomend_client/agent/broker.py):

    {"topic": "scan", "data": …}         publish (node → broker); delivery (broker → subscriber) is the same
    {"topic": "scan"}                    a tick: there was a message, and nobody needs to know what is in it
    {"topic": "odom", "time": 1764000012345678901, "fields": {"twist.twist.angular.z": 0.31}}
    {"subscribe": ["scan", "joy"]}       from now on, deliver these

`time` is when the message was made, in nanoseconds since the epoch by this computer's clock; without it,
the time of arrival counts. `fields` are what somebody looks at in a message that is too large or too
foreign to hand on whole. A line has at most LONGEST_LINE bytes. There are no acknowledgements and no
history: a subscriber that does not keep up loses the newest messages, as on any robot. Addresses are
`unix:PATH` or `tcp:HOST:PORT`; the agent gives its own to every process that it starts, in ROBOMEND_BUS.

Imports stay few: a node that needs this must be up in a tenth of a second.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator, Mapping

LONGEST_LINE = 64 * 1024

ENVIRONMENT = "ROBOMEND_BUS"

SEND_S = 1.0
"""A broker that takes no bytes for so long is gone, as far as the sender is concerned."""


class BusGone(Exception):
    """The broker is not there, or not any more; connect again."""


def parse_address(address: str) -> str | tuple[str, int]:
    """Return the path of `unix:PATH`, or host and port of `tcp:HOST:PORT`; ValueError says what is wrong."""
    kind, _, rest = address.partition(":")
    if kind == "unix" and rest:
        if len(rest.encode()) > 100:
            raise ValueError(
                f"{rest} is too long for a socket (100 bytes); use a shorter path or tcp:127.0.0.1:0"
            )
        return rest
    host, _, port = rest.rpartition(":")
    if kind == "tcp" and host and port.isascii() and port.isdigit() and int(port) < 65536:
        return host.strip("[]"), int(port)
    raise ValueError(f"{address!r} is no bus address; write unix:PATH or tcp:HOST:PORT")


class Bus:
    """A connection to the broker."""

    def __init__(self, address: str, connect_s: float = 1.0) -> None:
        where = parse_address(address)
        try:
            if isinstance(where, str):
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                self._socket.settimeout(connect_s)
                self._socket.connect(where)
            else:
                self._socket = socket.create_connection(where, timeout=connect_s)
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise BusGone(f"{address}: {error}") from error
        self._socket.settimeout(SEND_S)
        self._buffer = bytearray()

    def fileno(self) -> int:
        """For select and selectors."""
        return self._socket.fileno()

    def publish(
        self,
        topic: str,
        data: object = None,
        *,
        time_ns: int | None = None,
        fields: Mapping[str, object] | None = None,
    ) -> None:
        """Send one message; BusGone if the broker does not take it."""
        line = {"topic": topic, "data": data, "time": time_ns, "fields": fields}
        self._send({key: value for key, value in line.items() if value is not None})

    def subscribe(self, *topics: str) -> None:
        """Ask for these topics too."""
        self._send({"subscribe": list(topics)})

    def receive(self) -> Iterator[tuple[str, object]]:
        """Yield the messages of one read; call it when the socket is readable."""
        try:
            data = self._socket.recv(65536)
        except TimeoutError:
            return
        except OSError as error:
            raise BusGone(str(error)) from error
        if not data:
            raise BusGone("the broker closed the connection")
        self._buffer += data
        *lines, rest = bytes(self._buffer).split(b"\n")
        if len(rest) > LONGEST_LINE:
            raise BusGone(f"a line of more than {LONGEST_LINE} bytes")
        self._buffer = bytearray(rest)
        for line in lines:
            message = json.loads(line)
            yield message["topic"], message.get("data")

    def close(self) -> None:
        self._socket.close()

    def _send(self, message: dict[str, object]) -> None:
        line = json.dumps(message, separators=(",", ":")).encode() + b"\n"
        if len(line) > LONGEST_LINE:
            raise ValueError(f"a message of {len(line)} bytes; the bus takes {LONGEST_LINE}")
        try:
            self._socket.sendall(line)
        except OSError as error:
            # Part of the line may be out: this connection is of no use any more.
            self._socket.close()
            raise BusGone(str(error)) from error
