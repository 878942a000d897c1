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

The busiest request of all has a way of its own from here on (robomend.api.direct): where its head is that of
a plain batch, nothing is begun until its body is there, or a moment has passed. Who posts on and on to one
place sends one head on and on: the next one is read by what differs (robomend.api.known_head).
"""

from __future__ import annotations

import asyncio
import os
import socket
import weakref
from collections.abc import Callable
from typing import Any, NoReturn, cast

from starlette.responses import Response
from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from robomend.api.direct import MOMENT_S, Direct, Exchange
from robomend.api.eager import Eager
from robomend.api.heads import fault_of, too_large
from robomend.api.known_head import KnownHead
from robomend.api.problems import Problem
from robomend.api.straight import STRAIGHT, Straight

BATCHES = b"/observations"
"""The end of paths that are posted to again and again."""

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


class Protocol(HttpToolsProtocol):
    """uvicorn's HTTP/1.1, with limits on the head of a request; `limited` makes one with other limits."""

    max_head_bytes = 64 << 10
    head_timeout_s = 30.0
    once = False
    direct: Direct | None = None

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.give_back: GiveBack | None = None
        self.ending = False
        self._raw: asyncio.Transport | None = None
        self._heading = False  # a head has begun and is not whole
        self._receiving = False  # a message has begun and is not whole
        self._began = 0  # messages that began in the data that is being read
        self._overhead = 0  # bytes of the message that are no body
        self._body = 0
        self._rest = 0
        self._timer: asyncio.TimerHandle | None = None
        self._refusal: Problem | None = None
        self._plain: bytearray | None = None  # what came of the body of a plain batch
        self._known: KnownHead | None = None  # of plain batches that go to one place
        self._to_learn = False  # such a head has just been parsed
        self._place = b""  # where the latest plain batch that was parsed went to
        self._held = b""  # a known head, and of its body what came
        self._idle_s = 0.0  # since when the connection waits for its next request; the loop's clock
        self._running: RequestResponseCycle | Exchange | None = None  # the request that is answered next
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
        """Take what is not read by a known head."""
        inside = self._receiving
        self._began = int(inside)
        before = self._body if inside else 0
        super().data_received(data)
        if self._to_learn:
            self._to_learn = False
            if self._began == 1 and not inside:
                self._known = KnownHead.of(data, cast(Scope, self.scope))
        if self.ending or self._deaf:
            return
        if not self._receiving:
            if not self._began:  # empty lines before a request
                self._overhead += len(data)
                if self._overhead > self.max_head_bytes:
                    self._refuse(self._too_large())
            return
        if self._plain is not None:
            if self._timer is None:
                self._start_timer(MOMENT_S, self._begin_as_usual)
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
        if self.direct is not None and version == "1.1" and self._is_plain(self.direct):
            self._plain = bytearray()
            # Not of the first: whoever posts for many robots over one connection would have each read twice.
            self._to_learn, self._place = self.url == self._place, self.url
            return
        super().on_headers_complete()
        if self.once:
            self.cycle.keep_alive = False

    def on_body(self, body: bytes) -> None:
        self._body += len(body)
        if self._plain is not None:
            self._plain += body
        else:
            super().on_body(body)

    def on_message_complete(self) -> None:
        self._receiving = False
        self._stop_timer()
        if self._plain is None:
            super().on_message_complete()
            return
        body, self._plain = bytes(self._plain), None
        exchange = self._exchange(keep_alive=self.parser.should_keep_alive())
        assert self.direct is not None
        # Not at once: the parser may be in the middle of what it was fed.
        self.loop.call_soon(self._begin, self.direct, self.scope, body, exchange)

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: Any) -> None:
        self._running = cycle
        cast(Scope, cycle.scope)[STRAIGHT] = Straight(cycle)
        super()._start_asgi_task(cycle, app)

    def on_response_complete(self) -> None:
        self._idle_s = self.loop.time()
        if self.timeout_keep_alive_task is None or self.ending:
            super().on_response_complete()
        else:  # the timer of the answer before runs on, as that costs less than a new one
            self.server_state.total_requests += 1
        if self._deaf:
            return
        if self._receiving and not self.ending:
            self._start_timer(REST_S, self._cut_off)
        elif self.give_back is not None and self.cycle.keep_alive and not self.url.endswith(BATCHES):
            self._give_back(self.give_back)

    def timeout_keep_alive_handler(self) -> None:
        """The time for the next request is over; or it has come, or is a later one that is waited for."""
        self.timeout_keep_alive_task = None
        if not self.cycle.response_complete:
            return
        left_s = self._idle_s + self.timeout_keep_alive - self.loop.time()
        if left_s <= 0:
            super().timeout_keep_alive_handler()
        else:
            self.timeout_keep_alive_task = self.loop.call_later(left_s, self.timeout_keep_alive_handler)

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

    # --- plain batches

    def _is_plain(self, direct: Direct) -> bool:
        """Return whether the head that has come is that of a plain batch, with nothing before it."""
        busy = self.cycle is not None and not self.cycle.response_complete
        if busy or not self.url.endswith(b"/observations") or self.parser.get_method() != b"POST":
            return False
        if self.parser.should_upgrade():
            return False
        scope: Any = self.scope  # as an ASGI server fills it
        path = self.url.decode("ascii", "replace")
        scope.update({"method": "POST", "path": path, "raw_path": self.url, "query_string": b""})
        return direct.takes(scope)

    def _take(self, known: KnownHead, data: bytes) -> bool:
        """Begin to answer a plain batch, or wait for its body; False: its head is to be parsed."""
        direct, found = self.direct, known.read(data)
        if direct is None or found is None:
            return False
        scope, head, body = found
        missing = head + body - len(data)
        if missing < 0 or head > self.max_head_bytes or not 0 < body <= direct.most_bytes:
            return False
        if missing > 0:
            self._held, self._receiving = data, True
            self._unset_keepalive_if_required()
            if self._timer is None:
                self._start_timer(MOMENT_S, self._parse_held)
            return True
        if self._timer is not None:
            self._stop_timer()
        self.url, self._overhead = scope["raw_path"], 0
        self._begin(direct, scope, data[head:], self._exchange(keep_alive=True))
        return True

    def _exchange(self, *, keep_alive: bool) -> Exchange:
        """Return the request that is under way from now on."""
        exchange = Exchange(keep_alive)
        self.cycle = self._running = exchange  # type: ignore[assignment]  # all that uvicorn asks of one
        return exchange

    def _parse_held(self) -> None:
        """The rest of a body whose head is known does not come: have it awaited like any other."""
        self._timer = None
        data, self._held, self._receiving = self._held, b"", False
        self._parse(data)
        if self._plain is not None:
            self._stop_timer()
            self._begin_as_usual()

    def _begin_as_usual(self) -> None:
        """The body does not come: have it awaited like any other."""
        self._timer = None
        if self._plain is not None:
            body, self._plain = bytes(self._plain), None
            super().on_headers_complete()
            if body:
                super().on_body(body)

    def _begin(self, direct: Direct, scope: Any, body: bytes, exchange: Exchange) -> None:
        """Begin to answer a plain batch, while no task runs."""
        late = direct.refused(scope)
        note = direct.held if late is None else None
        Eager(self._answer(direct, scope, body, exchange, late), self.loop, self.tasks, note)

    async def _answer(
        self, direct: Direct, scope: Any, body: bytes, exchange: Exchange, late: Response | None
    ) -> None:
        if late is None:
            response = await direct.answer(scope, body)
            answer = direct.text(response, scope, exchange, self.server_state.default_headers)
        else:
            answer = direct.refusal(late, exchange, self.server_state.default_headers)
        if self.flow.write_paused and not exchange.disconnected:
            await self.flow.drain()
        self._send(answer, exchange)

    def _send(self, answer: bytes, exchange: Exchange) -> None:
        """Send the answer to a plain batch, whole."""
        if exchange.disconnected:
            return
        if self._raw is not None and not self.ending and not self._raw.is_closing():
            self._raw.write(answer)
        exchange.response_complete = True
        if not exchange.keep_alive:
            self.transport.close()
        self.on_response_complete()

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

    def _start_timer(self, delay_s: float, call: Any) -> None:
        self._stop_timer()
        self._timer = self.loop.call_later(delay_s, call)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

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
