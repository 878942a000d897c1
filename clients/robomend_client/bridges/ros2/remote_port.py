"""Whether anybody still has a port of another computer: that computer's own system says if not.

DDS cannot tell a process that was killed from a network that has split: both are silent. A datagram to a port
that nobody has is refused (ICMP), by a computer that is there; one that a firewall keeps from saying so, or
that is out of reach, says nothing.
"""

from __future__ import annotations

import socket
import time

NOTHING_SAID = b"RTPS\x02\x01\x01\x10" + bytes(12)
"""A message of DDS without a part: whoever takes it does nothing."""

AGAIN_S = 1.0
PATIENCE_S = 0.5
"""So long it is as it was: refusals come at once."""


class RemotePort:
    """One port, asked again and again."""

    def __init__(self, address: str, port: int) -> None:
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        self._to = (address, port)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._began_s = time.monotonic()
        self._asked_s = float("-inf")
        self._refused = False

    def runs(self) -> bool | None:
        """Return whether somebody has the port; True at first, and None when nothing was said."""
        if self._refused:
            return False
        now_s = time.monotonic()
        try:
            if now_s - self._asked_s >= AGAIN_S:
                self._asked_s = now_s
                self._socket.connect(self._to)
                self._socket.send(NOTHING_SAID)
            self._socket.recv(1)
        except ConnectionRefusedError:
            self._refused = True
            return False
        except (OSError, ValueError):  # nothing yet, or no way there
            pass
        return True if now_s - self._began_s < PATIENCE_S else None

    def close(self) -> None:
        self._socket.close()
