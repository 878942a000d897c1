"""Connections before a request is one: how large its head may be, how long it may take, what is no HTTP.

h11 reads one request after another: what a client sends behind a request under way waits unread, and an
upgrade is a plain request that is not upgraded. uvicorn around it bounds neither the head nor its time: a
client could hold a thousand connections with a byte a minute. Refusals are problems, as everywhere:

    head        bytes, lines and time                        431, 408
    no HTTP     400; chunk heads and trailers beyond measure 431
    the rest    of a body after its answer: time             the connection ends

A whole request that came before what is refused is answered all the same, and the connection ends after it.
A client that still sends when it is refused is listened to for a moment, as a reset would take the answer
away from it (RFC 9112, 9.6); robomend.api.edge does the same for answers that end their connection.

Between two requests a connection is the control lane's again, so that a stop on it waits for nobody
(robomend.api.control_lane); those of busy observers, which send batch after batch, stay here.
"""

from __future__ import annotations

import asyncio
import heapq
import os
import re
import socket
import sys
from collections.abc import Callable, Iterable

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from robomend.api.problems import Problem

GiveBack = Callable[[socket.socket], None]
"""Takes a connection between two requests."""

HEADERS = 200
"""Of a request. The shortest take some 100 bytes each, twenty times what was sent."""

HEAD_END = re.compile(rb"\n\r?\n")

BATCHES = b"/observations"
"""The end of paths that are posted to again and again."""

REST_S = 5.0
"""For what still comes of a body when its answer is complete."""

LINGER_S, LINGER_BYTES = 3.0, 16 << 20
"""For a client that sends all before it reads."""


class Protocol(H11Protocol):
    """uvicorn's HTTP/1.1, with limits on the head of a request; `limited` makes one with other limits."""

    max_head_bytes = 64 << 10
    head_timeout_s = 30.0
    once = False
    give_back: GiveBack | None = None
    _deaf = False  # what comes is dropped
    _dropped = 0  # bytes
    heard_s = 0.0  # the loop's clock: when something came, or was answered, last
    _awaited: str | None = None  # what the client has to send in time: a head, or the rest of a body
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        super().connection_made(transport)
        self.heard_s = self.loop.time()
        self._await("head", self.head_timeout_s)

    def connection_lost(self, exc: Exception | None) -> None:
        self._await(None)
        super().connection_lost(exc)

    def eof_received(self) -> bool:  # type: ignore[override]  # asyncio asks; uvicorn always says no
        """The client sends no more, or is gone: a whole request about the stop is done all the same."""
        cycle = self.cycle
        return self.once and cycle is not None and not (cycle.more_body or cycle.response_complete)

    def data_received(self, data: bytes) -> None:
        self.heard_s = self.loop.time()
        if self._deaf:
            self._dropped += len(data)
            if self._dropped > LINGER_BYTES:
                self.transport.abort()
        elif data := data if self._began else data.removeprefix(b"\r\n"):  # RFC 9112, 2.2
            super().data_received(data)

    def handle_events(self) -> None:
        if self.conn.their_state is h11.IDLE:
            data, _ = self.conn.trailing_data
            found = HEAD_END.search(data)
            size = len(data) if found is None else found.start()
            if size > self.max_head_bytes:
                self._refuse(431, f"the head of the request has more than {self.max_head_bytes} bytes")
                return
            if data.count(b"\n", 0, size) > HEADERS:
                self._refuse(431, f"the request has more than {HEADERS} headers")
                return
        super().handle_events()
        self._watch()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self.heard_s = self.loop.time()
        if self.transport.is_closing():
            return
        self._watch()
        if (
            self.give_back is not None
            and not self._began
            and not self.transport.get_write_buffer_size()
            and not self.scope["raw_path"].endswith(BATCHES)
        ):
            # A copy of the descriptor is the connection, too: what closes ours does not end it.
            connection = socket.socket(fileno=os.dup(self.transport.get_extra_info("socket").fileno()))
            connection.setblocking(False)
            self._deaf = True
            self.transport.abort()
            self.give_back(connection)

    def send_400_response(self, msg: str) -> None:
        """Answer what is no HTTP; uvicorn's own answer is plain text."""
        fault = sys.exception()
        if isinstance(fault, h11.RemoteProtocolError) and fault.error_status_hint == 431:
            self._refuse(431, f"what surrounds the body has more than {self.max_head_bytes} bytes")
        else:
            self._refuse(400, "this is no HTTP request")

    def shutdown(self) -> None:
        if self._awaited == "end":  # it was refused
            self.transport.close()
        else:
            super().shutdown()

    @property
    def waits(self) -> bool:
        """Whether it is for the client to say something: no whole request is under way."""
        return self.cycle is None or self.cycle.more_body or self.cycle.response_complete

    @property
    def _began(self) -> bool:
        """Whether anything of another message than those that were answered has come."""
        return self.conn.their_state is not h11.IDLE or bool(self.conn.trailing_data[0])

    def _watch(self) -> None:
        """Set the time for what the client has begun to send."""
        if self._deaf:
            return
        theirs = self.conn.their_state
        if theirs is h11.IDLE and self.conn.trailing_data[0]:
            self._await("head", self.head_timeout_s)
        elif theirs is h11.SEND_BODY and self.cycle.response_complete:
            self._await("rest", REST_S)
        else:
            self._await(None)

    def _await(self, what: str | None, within_s: float = 0.0) -> None:
        if what == self._awaited:
            return
        if self._timer is not None:
            self._timer.cancel()
        self._awaited = what
        self._timer = None if what is None else self.loop.call_later(within_s, self._late)

    def _late(self) -> None:
        if self._awaited == "head" and self._began:
            self._refuse(408, f"no whole head of a request came in {self.head_timeout_s:g} s")
        else:  # it never said anything, or says too much
            self.transport.abort()

    def _refuse(self, status: int, why: str) -> None:
        self._deaf = True
        cycle = self.cycle
        if cycle is not None and not cycle.response_complete:
            if not cycle.more_body:  # it came whole: the connection ends with its answer
                cycle.keep_alive = False
                self._await(None)
                return
            cycle.disconnected = True
            cycle.message_event.set()
            if cycle.response_started:  # nothing fits in between
                self.transport.close()
                return
        if self.conn.our_state is h11.DONE:  # the rest of a body, whose answer was given
            self.transport.close()
            return
        problem = Problem(status, why)
        answer = problem.response()
        head = f"HTTP/1.1 {status} {problem.title}\r\nconnection: close\r\n"
        head += "".join(f"{name.decode()}: {value.decode()}\r\n" for name, value in answer.raw_headers)
        self.transport.write(head.encode() + b"\r\n" + bytes(answer.body))
        if self.transport.can_write_eof():
            self.transport.write_eof()
        self._await("end", LINGER_S)


def make_room(connections: Iterable[Protocol], most: int) -> bool:
    """Have room for one connection more: where there is none, those that were silent for the longest end.

    Returns:
        False: every one of them is being answered.
    """
    every = [one for one in connections if not one.transport.is_closing()]
    if len(every) < most:
        return True
    waiting = [one for one in every if one.waits]
    # Some at once: to look for them takes longer than to end one.
    for one in heapq.nsmallest(1 + most // 16, waiting, key=lambda one: one.heard_s):
        one.transport.abort()
    return bool(waiting)


def limited(max_head_bytes: int, head_timeout_s: float, *, once: bool = False) -> type[Protocol]:
    """Return the protocol with these limits; uvicorn makes one for each connection and passes nothing on.

    With `once`, an answer ends its connection: a request that came whole is done though its client is gone.
    """
    limits = {"max_head_bytes": max_head_bytes, "head_timeout_s": head_timeout_s, "once": once}
    return type("Protocol", (Protocol,), limits)
