"""Connections before a request is one: how large its head may be, how long it may take, what is no HTTP.

uvicorn's protocol bounds neither the head nor its time: a client could fill the memory with one endless
header, or hold a thousand connections with a byte a minute. What is refused here is answered with a problem,
as everywhere. All of it holds before anybody knows whose request it is:

    head       bytes, headers and time                          431, 408
    trailers   dropped; bytes, as those of chunk heads          431
    pipeline   requests behind one under way, and their headers the connection ends
    the rest   of a body after its answer: bytes and time       the connection ends

A whole request that came before what is refused is answered all the same, and the connection ends after it.

A connection that ends while its client still sends is not cut off at once: the rest is read and dropped for a
moment, as a reset would take the answer away from a client that has not read it yet (RFC 9112, 9.6).

Between two requests a connection is the control lane's again, so that a stop on it waits for nobody
(robomend.api.control_lane); those of busy observers, which send batch after batch, stay here.

The busiest request of all has a way of its own from here on: robomend.api.batch_connection.
"""

from __future__ import annotations

import asyncio
import os
import socket
import weakref
from collections.abc import Callable
from typing import Any, NoReturn, cast

from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import RequestResponseCycle

from robomend.api.batch_connection import BATCHES, BatchConnection
from robomend.api.direct import Direct, Exchange
from robomend.api.heads import fault_of, too_large
from robomend.api.problems import Problem
from robomend.api.straight import STRAIGHT, Straight

GiveBack = Callable[[socket.socket], None]
"""Takes a connection between two requests."""

HEADERS = 200
"""Of a request. The shortest take some 100 bytes each, twenty times what was sent."""

PIPELINED = 50
"""Requests that may wait behind one under way on a connection; each holds some kilobytes."""

PIPELINED_HEADERS = 2000
"""Of those requests together; in bytes, as many as one head may have."""

REST_BYTES = 256 << 10
"""Of a body that still comes when its answer is complete; read so that the connection can be used again."""

REST_S = 5.0

LINGER_BYTES = 16 << 20
"""Read and dropped from a connection that ends, for a client that sends all before it reads."""

LINGER_S = 3.0


class Transport:
    """A connection as answers see it: closing it lets the client read the answer first."""

    def __init__(self, transport: asyncio.Transport, protocol: Protocol) -> None:
        self._transport = transport
        self._protocol = weakref.ref(protocol)  # no circle: what a connection held is free when it is gone

    def write(self, data: bytes) -> None:
        """Send; nothing where the connection has ended, or is about to."""
        protocol = self._protocol()
        if protocol is not None and not protocol.ending and not self._transport.is_closing():
            self._transport.write(data)

    def close(self) -> None:
        """End the connection, now or when the client has stopped sending."""
        protocol = self._protocol()
        if protocol is not None:
            protocol.end()

    def is_closing(self) -> bool:
        """Whether nothing more is to be answered."""
        protocol = self._protocol()
        return protocol is None or protocol.ending or self._transport.is_closing()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)


class Protocol(BatchConnection):
    """uvicorn's HTTP/1.1, with limits on the head of a request; `limited` makes one with other limits."""

    head_timeout_s = 30.0
    once = False

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.give_back: GiveBack | None = None
        self._heading = False  # a head has begun and is not whole
        self._began = 0  # messages that began in the data that is being read
        self._body = 0
        self._rest = 0
        self._refusal: Problem | None = None
        self._deaf = False  # what came is refused; requests before it have their answers yet to come

    # --- the connection

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        super().connection_made(transport)
        self._raw = transport
        self.transport = Transport(transport, self)  # type: ignore[assignment]  # all that uvicorn asks of one
        self._start_timer(self.head_timeout_s, self._late)

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_timer()
        super().connection_lost(exc)
        self.headers, self._known = [], None

    def eof_received(self) -> bool:  # type: ignore[override]  # asyncio asks; uvicorn always says no
        """The client sends no more, or is gone: a whole request about the stop is done all the same."""
        if self.ending and self._raw is not None:
            self._raw.close()
        super().eof_received()
        cycle = self.cycle
        return self.once and cycle is not None and not (cycle.more_body or cycle.response_complete)

    def data_received(self, data: bytes) -> None:
        if self.ending or self._deaf:
            self._drop(data, LINGER_BYTES)
            return
        if self._held:
            data, self._held, self._receiving = self._held + data, b"", False
        known = self._known
        if (
            known is None
            or self._receiving
            or not self.cycle.response_complete
            or not self._take(known, data)
        ):
            self._parse(data)

    def _parse(self, data: bytes) -> None:
        inside = self._receiving
        self._began = int(inside)
        before = self._body if inside else 0
        super()._parse(data)
        self._learn(data, whole=self._began == 1 and not inside)
        if self.ending or self._deaf:
            return
        if not self._receiving:
            if not self._began:  # empty lines before a request
                self._overhead += len(data)
                if self._overhead > self.max_head_bytes:
                    self._refuse(self._too_large())
            return
        if self._plain is not None:
            self._wait_a_moment(self._begin_as_usual)
            return
        if self._heading and self._timer is None:
            self._start_timer(self.head_timeout_s, self._late)
        if self._began > 1:  # what of it belongs to the last message is not known, and is not much
            return
        if self.cycle is not None and self.cycle.response_complete and not self._heading:
            self._drop(data, REST_BYTES)
            return
        self._overhead += len(data) - (self._body - before)
        if self._overhead > self.max_head_bytes + 16 * self._body:  # a chunk of one byte takes six
            self._refuse(self._too_large())

    def end(self) -> None:
        """End the connection, when the client has stopped sending or after a moment."""
        if self.ending or self._raw is None:
            return
        self.ending = True
        self.pipeline.clear()  # nobody is going to answer them
        self._stop_timer()
        if not self._receiving:
            self._raw.close()
            return
        self._rest = 0
        self.flow.resume_reading()
        if self._raw.can_write_eof():
            self._raw.write_eof()
        self._start_timer(LINGER_S, self._cut_off)

    def _drop(self, data: bytes, most: int) -> None:
        self._rest += len(data)
        if self._rest > most:
            self._cut_off()

    def _cut_off(self) -> None:
        if self.ending and self._raw is not None:
            self._raw.abort()
        else:
            self.end()

    # --- the parser

    def on_message_begin(self) -> None:
        super().on_message_begin()
        self._heading = self._receiving = True
        self._began += 1
        self._overhead = self._body = self._rest = 0

    def on_header(self, name: bytes, value: bytes) -> None:
        if not self._heading:  # a trailer, which nobody reads
            return
        if len(self.headers) >= HEADERS:
            self._refuse_head(Problem(431, f"the request has more than {HEADERS} headers"))
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        self._heading = False
        self._stop_timer()
        version = self.parser.get_http_version()
        fault = fault_of(self.url, self.headers, version, self.max_head_bytes)
        if fault is None and self.pipeline and self._too_many_wait():
            fault = Problem(503, f"more than {PIPELINED} requests wait on this connection")
        if fault is not None:
            self._refuse_head(fault)
        if version == "1.1" and self._takes_up():
            return
        super().on_headers_complete()
        if self.once:
            self.cycle.keep_alive = False

    def on_body(self, body: bytes) -> None:
        self._body += len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        self._receiving = False
        self._stop_timer()
        super().on_message_complete()

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: Any) -> None:
        self._running = cycle
        cast(Scope, cycle.scope)[STRAIGHT] = Straight(cycle)
        super()._start_asgi_task(cycle, app)

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self._deaf:
            return
        if self._receiving and not self.ending:
            self._start_timer(REST_S, self._cut_off)
        elif self.give_back is not None and self.cycle.keep_alive and not self.url.endswith(BATCHES):
            self._give_back(self.give_back)

    def _give_back(self, give_back: GiveBack) -> None:
        """Let go of the connection, if the next request has not begun and nothing is left to be sent."""
        raw = self._raw
        if raw is None or raw.is_closing() or self.ending or not self.cycle.response_complete:
            return  # after a request that came behind this one, the connection goes back
        if raw.get_write_buffer_size():
            return
        # A copy of the descriptor is the connection, too: what closes ours does not end it.
        connection = socket.socket(fileno=os.dup(raw.get_extra_info("socket").fileno()))
        connection.setblocking(False)
        self.ending = True
        self._stop_timer()
        raw.abort()
        give_back(connection)

    def send_400_response(self, msg: str) -> None:
        """Answer what is no HTTP; uvicorn's own answer is plain text."""
        self._refuse(self._refusal or Problem(400, "this is no HTTP request", code="bad-request"))

    # --- refusing

    def _refuse_head(self, problem: Problem) -> NoReturn:
        """Refuse a request for its head: the parser ends, and asks for send_400_response."""
        self._refusal = problem
        raise ValueError(problem.detail)

    def _too_many_wait(self) -> bool:
        """Whether what waits behind the request under way is as much as may."""
        sizes = [len(n) + len(v) for cycle, _ in self.pipeline for n, v in cycle.scope["headers"]]
        full = len(self.pipeline) >= PIPELINED or len(sizes) >= PIPELINED_HEADERS
        return full or sum(sizes) > self.max_head_bytes

    def _too_large(self) -> Problem:
        return too_large(self.max_head_bytes)

    def _late(self) -> None:
        self._timer = None
        if self._heading:
            self._refuse(Problem(408, f"no whole head of a request came in {self.head_timeout_s:g} s"))
        else:
            self.end()  # it never said anything

    def _refuse(self, problem: Problem) -> None:
        whole = self._last_whole()
        if whole is not None:
            whole.keep_alive = False
            self._deaf = self._receiving = True  # whatever it sends is not going to be read
            self._stop_timer()
            return
        cycle = self.cycle
        answered = cycle is not None and (cycle.response_started or not cycle.more_body)
        if answered and not (cycle.response_complete and self._of_its_own()):
            self.end()  # an answer is under way or was given: nothing fits in between
            return
        answer = problem.response()
        head = f"HTTP/1.1 {problem.status} {problem.title}\r\nconnection: close\r\n"
        head += "".join(f"{name.decode()}: {value.decode()}\r\n" for name, value in answer.raw_headers)
        self.transport.write(head.encode() + b"\r\n" + bytes(answer.body))
        self._receiving = True  # whatever it sends is not going to be read
        self.end()

    def _last_whole(self) -> RequestResponseCycle | Exchange | None:
        """Return the latest request that came whole and has no answer yet; one behind it is forgotten."""
        if self.pipeline and self.cycle.more_body:
            self.pipeline.popleft()
            self.cycle = self.pipeline[0][0] if self.pipeline else self._running  # type: ignore[assignment]  # as above
        cycle = self.cycle
        return None if cycle is None or cycle.more_body or cycle.response_complete else cycle

    def _of_its_own(self) -> bool:
        """Whether the message at fault is a later one than the one that was answered last."""
        return self._heading or self._refusal is not None or not self._receiving


def limited(
    max_head_bytes: int, head_timeout_s: float, *, once: bool = False, direct: Direct | None = None
) -> type[Protocol]:
    """Return the protocol with these limits; uvicorn makes one for each connection and passes nothing on.

    With `once`, an answer ends its connection; `direct` answers plain batches.
    """
    limits: dict[str, Any] = {"max_head_bytes": max_head_bytes, "head_timeout_s": head_timeout_s}
    limits |= {"once": once, "direct": direct}
    return type("Protocol", (Protocol,), limits)
