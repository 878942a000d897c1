"""What an error that came of connecting means."""

from __future__ import annotations

import errno
import os
import socket

import pytest

from robomend_client.bridges.ros1.xmlrpc import NobodyListens, OutOfReach, PeerError, unreachable


def connecting(*numbers: int) -> OSError:
    """Return what asyncio raises: of several addresses one text."""
    errors = [OSError(number, f"Connect call failed: {os.strerror(number)}") for number in numbers]
    return errors[0] if len(errors) == 1 else OSError(f"Multiple exceptions: {', '.join(map(str, errors))}")


@pytest.mark.parametrize(
    ("error", "means"),
    [
        (connecting(errno.ECONNREFUSED), NobodyListens),
        (connecting(errno.ECONNRESET), NobodyListens),  # it was killed, and its socket was still open
        (connecting(errno.ECONNREFUSED, errno.ECONNREFUSED), NobodyListens),
        (connecting(errno.ECONNREFUSED, errno.ECONNRESET), NobodyListens),
        (connecting(errno.ECONNREFUSED, errno.EHOSTUNREACH), OutOfReach),
        (connecting(errno.EHOSTUNREACH), OutOfReach),
        (connecting(errno.ENETUNREACH), OutOfReach),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), OutOfReach),
    ],
)
def test_who_refuses_or_hangs_up_does_not_run_and_of_who_is_out_of_reach_nothing_is_known(
    error: OSError, means: type[PeerError]
) -> None:
    assert type(unreachable("robot", 1, error)) is means
