"""A connection on which batches of observations are posted: a way of their own, from the bytes to the answer.

    a head that the parser found plain ──► its body ─────────────────┐
                   │ the next one is the same but for a few values   ├──► Direct ──► one write
    a known head (known_head.py) and its body, without the parser ───┘
                   │ the body does not come in a moment
                   └──► the parser, and a request as all others are

What is begun here is begun in the turn of the event loop in which it came (eager.py), and nothing of what it
costs is a task's, a timer's or a parser's. protocol.py has the limits that hold before any of this.
"""

from __future__ import annotations

import asyncio
from typing import Any, cast

from starlette.responses import Response
from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from robomend.api.direct import MOMENT_S, Direct, Exchange
from robomend.api.eager import Eager
from robomend.api.known_head import KnownHead

BATCHES = b"/observations"
"""The end of paths that are posted to again and again."""


class BatchConnection(HttpToolsProtocol):
    """See the module."""

    max_head_bytes = 64 << 10
    direct: Direct | None = None
    """Answers plain batches; None: they are requests as all others are."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.ending = False
        self._raw: asyncio.Transport | None = None
        self._receiving = False  # a message has begun and is not whole
        self._overhead = 0  # bytes of the message that are no body
        self._plain: bytearray | None = None  # what came of the body of a plain batch
        self._known: KnownHead | None = None  # of plain batches that go to one place
        self._to_learn = False  # such a head has just been parsed
        self._place = b""  # where the latest plain batch that was parsed went to
        self._held = b""  # a known head, and of its body what came
        self._running: RequestResponseCycle | Exchange | None = None  # the request that is answered next
        self._idle_s = 0.0  # since when the connection waits for its next request; the loop's clock
        self._timer: asyncio.TimerHandle | None = None

    def _parse(self, data: bytes) -> None:
        """Give the parser what is not read by a known head."""
        super().data_received(data)

    # --- found by the parser

    def on_body(self, body: bytes) -> None:
        if self._plain is not None:
            self._plain += body
        else:
            super().on_body(body)

    def on_message_complete(self) -> None:
        if self._plain is None:
            super().on_message_complete()
            return
        body, self._plain = bytes(self._plain), None
        exchange = self._exchange(keep_alive=self.parser.should_keep_alive())
        assert self.direct is not None
        # Not at once: the parser may be in the middle of what it was fed.
        self.loop.call_soon(self._begin, self.direct, self.scope, body, exchange)

    def _takes_up(self) -> bool:
        """Take up the head that has come if it is a plain batch's, with nothing before it: wait for its
        body, and begin nothing else. Return whether it is.
        """
        direct = self.direct
        if direct is None or not self.url.endswith(BATCHES) or self.parser.get_method() != b"POST":
            return False
        if self.cycle is not None and not self.cycle.response_complete:
            return False
        if self.parser.should_upgrade():
            return False
        scope: Any = self.scope  # as an ASGI server fills it
        path = self.url.decode("ascii", "replace")
        scope.update({"method": "POST", "path": path, "raw_path": self.url, "query_string": b""})
        if not direct.takes(scope):
            return False
        self._plain = bytearray()
        # Not of the first: whoever posts for many robots over one connection would have each read twice.
        self._to_learn, self._place = self.url == self._place, self.url
        return True

    def _learn(self, data: bytes, *, whole: bool) -> None:
        """Remember a head that has just been parsed, if it is to be; `whole`: the data begin with it."""
        if self._to_learn and whole:
            self._known = KnownHead.of(data, cast(Scope, self.scope))
        self._to_learn = False

    def _begin_as_usual(self) -> None:
        """The body does not come: have it awaited like any other."""
        self._timer = None
        if self._plain is not None:
            body, self._plain = bytes(self._plain), None
            super().on_headers_complete()
            if body:
                super().on_body(body)

    # --- known by the one before

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
            self._wait_a_moment(self._parse_held)
            return True
        if self._timer is not None:
            self._stop_timer()
        self.url, self._overhead = scope["raw_path"], 0
        self._begin(direct, scope, data[head:], self._exchange(keep_alive=True))
        return True

    def _parse_held(self) -> None:
        """The rest of a body whose head is known does not come: have it awaited like any other."""
        self._timer = None
        data, self._held, self._receiving = self._held, b"", False
        self._parse(data)
        if self._plain is not None:
            self._stop_timer()
            self._begin_as_usual()

    # --- answered

    def _exchange(self, *, keep_alive: bool) -> Exchange:
        """Return the request that is under way from now on."""
        exchange = Exchange(keep_alive)
        self.cycle = self._running = exchange  # type: ignore[assignment]  # all that uvicorn asks of one
        return exchange

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

    # --- waiting for the next one

    def on_response_complete(self) -> None:
        self._idle_s = self.loop.time()
        if self.timeout_keep_alive_task is None or self.ending:
            super().on_response_complete()
        else:  # the timer of the answer before runs on, as that costs less than a new one
            self.server_state.total_requests += 1

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

    def _wait_a_moment(self, call: Any) -> None:
        """Call back if the rest of a body has not come then; what comes of it meanwhile puts nothing off."""
        if self._timer is None:
            self._start_timer(MOMENT_S, call)

    def _start_timer(self, delay_s: float, call: Any) -> None:
        self._stop_timer()
        self._timer = self.loop.call_later(delay_s, call)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
