"""A piece goes straight to a connection only where the usual way would send it at once, and as it would."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import RequestResponseCycle

from robomend.api.straight import Straight


class Transport:
    """Keeps what is written."""

    def __init__(self) -> None:
        self.written = b""

    def write(self, data: bytes) -> None:
        self.written += data


def begun(*headers: tuple[bytes, bytes], method: str = "GET") -> tuple[RequestResponseCycle, Transport]:
    """Return an answer that has begun, with these headers, and its connection."""
    transport: Any = Transport()
    scope: Any = {"type": "http", "method": method, "http_version": "1.1"}
    logger = logging.getLogger("nobody")
    cycle = RequestResponseCycle(
        *(scope, transport, FlowControl(transport), logger, logger, False, [], asyncio.Event(), False, True),
        lambda: None,
    )
    asyncio.run(cycle.send({"type": "http.response.start", "status": 200, "headers": list(headers)}))
    transport.written = b""
    return cycle, transport


def test_a_piece_is_sent_as_the_usual_way_sends_it() -> None:
    (usual, one), (straight, other) = begun(), begun()
    asyncio.run(usual.send({"type": "http.response.body", "body": b"a piece" * 9, "more_body": True}))
    assert Straight(straight).send(b"a piece" * 9)
    assert one.written == other.written


def paused(cycle: RequestResponseCycle) -> None:
    cycle.flow.pause_writing()


def disconnected(cycle: RequestResponseCycle) -> None:
    cycle.disconnected = True


def complete(cycle: RequestResponseCycle) -> None:
    asyncio.run(cycle.send({"type": "http.response.body", "body": b"", "more_body": False}))


@pytest.mark.parametrize("happen", [paused, disconnected, complete])
def test_what_would_wait_or_go_nowhere_is_not_sent(happen: Any) -> None:
    cycle, transport = begun()
    happen(cycle)
    transport.written = b""
    assert not Straight(cycle).send(b"a piece")
    assert transport.written == b""


def test_an_answer_of_a_known_length_and_one_without_a_body_have_no_pieces() -> None:
    known, _ = begun((b"content-length", b"7"))
    without, _ = begun(method="HEAD")
    assert not Straight(known).send(b"a piece")
    assert not Straight(without).send(b"a piece")


def test_an_answer_that_is_gone_has_no_pieces() -> None:
    cycle, _ = begun()
    straight = Straight(cycle)
    del cycle
    assert not straight.send(b"a piece")
