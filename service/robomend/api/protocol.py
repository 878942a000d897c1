"""Connections before a request is one: how large its head may be, how long it may take, what is no HTTP.

uvicorn's protocol bounds neither the head nor its time: a client could fill the memory with one endless
header, or hold a thousand connections with a byte a minute. What is refused here is answered with a problem,
as everywhere.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from robomend.api.problems import Problem


class Protocol(HttpToolsProtocol):
    """uvicorn's HTTP/1.1, with limits on the head of a request; `limited` makes one with other limits."""

    max_head_bytes = 64 << 10
    head_timeout_s = 30.0

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._head_bytes = 0  # of a head that is not whole yet
        self._heading = False
        self._head_timer: asyncio.TimerHandle | None = None
        self._refusal: Problem | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        super().connection_made(transport)
        self._wait_for_head()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self.transport.is_closing():
            return  # refused already
        super().data_received(data)
        if self._heading and not self.transport.is_closing():
            self._head_bytes += len(data)
            if self._head_bytes > self.max_head_bytes:
                self._refuse(self._too_large())
            elif self._head_timer is None:
                self._wait_for_head()

    def on_message_begin(self) -> None:
        super().on_message_begin()
        self._heading, self._head_bytes = True, 0

    def on_headers_complete(self) -> None:
        self._heading = False
        self._stop_waiting()
        size, hosts = len(self.url), 0
        for name, value in self.headers:
            size += len(name) + len(value)
            hosts += name == b"host"
        if size > self.max_head_bytes:
            self._refusal = self._too_large()
        elif hosts > 1:  # which one a proxy before us has looked at is anybody's guess
            self._refusal = Problem(400, "there is more than one Host header")
        if self._refusal is not None:
            raise ValueError(self._refusal.detail)  # the parser ends, and asks for send_400_response
        super().on_headers_complete()

    def send_400_response(self, msg: str) -> None:
        """Answer what is no HTTP; uvicorn's own answer is plain text."""
        self._refuse(self._refusal or Problem(400, "this is no HTTP request", code="bad-request"))

    def _too_large(self) -> Problem:
        return Problem(431, f"the head of the request has more than {self.max_head_bytes} bytes")

    def _wait_for_head(self) -> None:
        self._head_timer = self.loop.call_later(self.head_timeout_s, self._late)

    def _stop_waiting(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _late(self) -> None:
        self._head_timer = None
        if self._heading:
            self._refuse(Problem(408, f"no whole head of a request came in {self.head_timeout_s:g} s"))
        else:
            self.transport.close()  # it never said anything

    def _refuse(self, problem: Problem) -> None:
        self._stop_waiting()
        answer, cycle = problem.response(), self.cycle
        if (
            cycle is not None
            and not cycle.response_complete
            and (cycle.response_started or not cycle.more_body)
        ):
            self.transport.close()  # an answer to an earlier request is under way: nothing fits in between
            return
        head = f"HTTP/1.1 {problem.status} {problem.title}\r\nconnection: close\r\n"
        head += "".join(f"{name.decode()}: {value.decode()}\r\n" for name, value in answer.raw_headers)
        self.transport.write(head.encode() + b"\r\n" + bytes(answer.body))
        self.transport.close()


def limited(max_head_bytes: int, head_timeout_s: float) -> type[Protocol]:
    """Return the protocol with these limits; uvicorn makes one for each connection and passes nothing on."""
    return type("Protocol", (Protocol,), {"max_head_bytes": max_head_bytes, "head_timeout_s": head_timeout_s})
