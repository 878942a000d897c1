"""Pieces of an answer under way that go straight to its connection, past the layers of the application.

Each layer around an application passes every piece of an answer on, and waits for the next to have done so.
For an event stream that is ten calls for each event of each client, and none of them does anything with a
piece. The beginning and the end of an answer, and a piece that has to wait, go the usual way.
"""

from __future__ import annotations

import weakref

from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import RequestResponseCycle

STRAIGHT = "robomend.straight"
"""In a scope, where its connection takes pieces: a `Straight`."""


class Straight:
    """The way to a request's connection. Belongs to its event loop."""

    __slots__ = ("_cycle",)

    def __init__(self, cycle: RequestResponseCycle) -> None:
        self._cycle = weakref.ref(cycle)  # no circle: its scope has this

    def send(self, piece: bytes) -> bool:
        """Send a piece of an answer that is sent in chunks; False: it has to go the usual way, or nowhere."""
        cycle = self._cycle()
        if cycle is None or not cycle.chunked_encoding or cycle.response_complete or cycle.disconnected:
            return False
        if cycle.flow.write_paused:
            return False
        cycle.transport.write(b"%x\r\n%b\r\n" % (len(piece), piece))
        return True


def straight(scope: Scope) -> Straight | None:
    """Return the way to a request's connection, where there is one."""
    found: Straight | None = scope.get(STRAIGHT)
    return found
