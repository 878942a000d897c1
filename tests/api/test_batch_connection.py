"""A connection whose plain batches are known by their heads: who may do what is decided for each of them."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import anyio
import pytest
from tests.api.conftest import Service, StartService, running
from tests.api.test_direct import BODY, ask, connect, head, read
from tests.waiting import until
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from robomend.api import batch_connection
from robomend.api.problems import Problem
from robomend.api.protocol import Protocol
from robomend.api.strict_json import AT_ONCE
from robomend.settings import Settings
from robomend.store import Transaction, api_keys


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """What was given to the parser."""
    given: list[bytes] = []
    usual = HttpToolsProtocol.data_received

    def data_received(self: HttpToolsProtocol, data: bytes) -> None:
        given.append(data)
        usual(self, data)

    monkeypatch.setattr(HttpToolsProtocol, "data_received", data_received)
    return given


@contextmanager
def acquainted(service: Service, *more: str) -> Iterator[socket.socket]:
    """Yield a connection on which two batches with this head have been answered: the next one's is known."""
    with connect(service) as connection:
        for _ in range(2):
            connection.sendall(head(*more) + BODY)
            assert read(connection)[0] == 200
        yield connection


def test_the_head_of_an_observer_is_parsed_twice_and_known_then(there: Service, parsed: list[bytes]) -> None:
    with connect(there) as connection:
        revisions = []
        for number, body in enumerate([BODY, BODY, b'{"observations": ["ok(scan)"]}', b"{}", BODY]):
            connection.sendall(head(f"Idempotency-Key: once-{number}", length=len(body)) + body)
            status, headers, said = read(connection)
            assert status == 200
            assert headers["content-type"] == "application/json"
            revisions.append(said["revision"])
    assert parsed == [head(f"Idempotency-Key: once-{number}") + BODY for number in range(2)]
    assert revisions == sorted(revisions)


def test_of_who_posts_for_many_robots_over_one_connection_nothing_is_remembered(
    there: Service, parsed: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = protocols(monkeypatch)
    with connect(there) as connection:
        for robot in ("direct", "nobody") * 2:
            connection.sendall(head(robot=robot) + BODY)
            assert read(connection)[0] == {"direct": 200, "nobody": 404}[robot]
    assert len(parsed) == 4
    assert made[0]._known is None


def test_a_repeat_by_a_known_head_has_its_first_answer(there: Service, parsed: list[bytes]) -> None:
    same = head("Idempotency-Key: twice") + b'{"observations": ["not ok(odom)"]}'
    with acquainted(there, "Idempotency-Key: first") as connection:
        connection.sendall(same)
        first = read(connection)[2]
        connection.sendall(head("Idempotency-Key: other", length=30) + b'{"observations": ["ok(odom)"]}')
        other = read(connection)[2]
        connection.sendall(same)
        again = read(connection)[2]
    assert len(parsed) == 2
    assert first == again
    assert other["revision"] > first["revision"]


def test_a_body_that_comes_behind_a_known_head_is_waited_for(there: Service, parsed: list[bytes]) -> None:
    with acquainted(there) as connection:
        for piece in (head(), BODY[:7], BODY[7:]):
            connection.sendall(piece)
        assert read(connection)[0] == 200
        connection.sendall(head() + BODY)
        assert read(connection)[0] == 200
    assert parsed[0] == head() + BODY


def test_a_body_that_does_not_come_behind_a_known_head_is_watched_like_any_other(
    there: Service, parsed: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = threading.Event()
    usual = Protocol._begin_as_usual

    def begin(self: Protocol) -> None:
        usual(self)
        begun.set()

    with acquainted(there) as connection:
        monkeypatch.setattr(batch_connection, "MOMENT_S", 0.0)
        monkeypatch.setattr(Protocol, "_begin_as_usual", begin)
        connection.sendall(head() + BODY[:5])
        assert begun.wait(30)
        connection.sendall(BODY[5:])
        assert read(connection)[0] == 200
        connection.sendall(head() + BODY)
        assert read(connection)[0] == 200
    assert head() + BODY[:5] in parsed


def test_a_body_that_drips_behind_a_known_head_has_no_more_than_its_moment(
    there: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = protocols(monkeypatch)
    monkeypatch.setattr(batch_connection, "MOMENT_S", 60.0)
    with acquainted(there) as connection:
        timers = []
        sent = b""
        for piece in (head() + BODY[:5], BODY[5:10], BODY[10:15]):
            connection.sendall(piece)
            sent += piece
            until(partial(came, made[0], sent), "it has not come")
            timers.append(made[0]._timer)
        connection.sendall(BODY[15:])
        assert read(connection)[0] == 200
    assert timers[0] is not None
    assert timers == [timers[0]] * 3
    assert made[0]._timer is None


def came(connection: Protocol, data: bytes) -> bool:
    return connection._held == data


def protocols(monkeypatch: pytest.MonkeyPatch) -> list[Protocol]:
    """Return the connections that are made from now on."""
    made: list[Protocol] = []
    usual = Protocol.connection_made

    def connection_made(self: Protocol, transport: Any) -> None:
        usual(self, transport)
        made.append(self)

    monkeypatch.setattr(Protocol, "connection_made", connection_made)
    return made


def test_who_goes_away_behind_a_known_head_harms_nobody(there: Service) -> None:
    with acquainted(there) as connection:
        connection.sendall(head() + BODY[:5])
        connection.shutdown(socket.SHUT_WR)
        assert connection.recv(1) == b""
    assert ask(there, head() + BODY)[0] == 200


def test_requests_behind_one_with_a_known_head_are_answered_in_their_order(
    there: Service, parsed: list[bytes]
) -> None:
    with acquainted(there) as connection:
        other = b"GET /version-info HTTP/1.1\r\nHost: localhost\r\n\r\n"
        connection.sendall(head() + BODY + other)
        assert "revision" in read(connection)[2]
        assert "robomend" in read(connection)[2]
    assert len(parsed) == 3


def test_what_a_key_may_is_asked_for_each_request_with_a_known_head(start: StartService) -> None:
    service = start()
    service.with_robot("direct")
    key = service.key("robot", "direct")
    own = f"Authorization: Bearer {key}"
    wire = head(own) + BODY
    with acquainted(service, own) as connection:
        connection.sendall(wire)
        assert read(connection)[0] == 200
        revoke(service)
        connection.sendall(wire)
        assert read(connection)[0] == 401


def revoke(service: Service) -> None:
    def every(tx: Transaction) -> None:
        for key in api_keys.every(tx):
            api_keys.revoke(tx, key.id)

    service.run(service.runtime.store.write(every))
    service.runtime.app.state.gate.ring.forget()


def test_requests_with_a_known_head_are_counted_against_their_rate(start: StartService) -> None:
    service = start(requests_per_s=0.001, burst=5)
    service.with_robot("direct")  # takes two
    with connect(service) as connection:
        statuses = []
        for _ in range(4):
            connection.sendall(head() + BODY)
            statuses.append(read(connection)[0])
    assert statuses == [200, 200, 200, 429]


def test_an_overload_refuses_what_has_a_known_head_at_once(
    there: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = there.runtime.parts

    async def held() -> int:
        """Return how many requests have held the loop; in a turn behind what has been answered."""
        return sum(parts.metrics.hold_s.counts)

    with acquainted(there) as connection:
        before = there.run(held())
        monkeypatch.setattr(parts.shedding, "refusal", lambda: Problem(503, "more come than can be kept"))
        connection.sendall(head("X-Request-ID: mine") + BODY)
        refused = read(connection)
        connection.sendall(head() + BODY)
        again = read(connection)
        monkeypatch.undo()
        assert there.run(held()) == before
        connection.sendall(head() + BODY)
        assert read(connection)[0] == 200
        assert there.run(held()) == before + 1
    for status, headers, body in (refused, again):
        assert (status, body["code"], headers["retry-after"]) == (503, "overloaded", "1")
    assert refused[2]["request_id"] == "mine"


def test_a_body_that_is_none_or_a_long_one_goes_the_usual_way_behind_a_known_head(
    there: Service, parsed: list[bytes]
) -> None:
    long = BODY + b" " * AT_ONCE
    with acquainted(there) as connection:
        connection.sendall(head(length=len(long)) + long)
        assert read(connection)[0] == 200
        connection.sendall(head(length=0))
        assert read(connection)[2]["code"] == "malformed-json"
    assert b"".join(parsed[2:]) == head(length=len(long)) + long + head(length=0)


def test_a_known_head_beyond_the_limit_is_refused(start: StartService) -> None:
    service = start(max_head_bytes=1024)
    service.with_robot("direct")
    usual = "User-Agent: " + "u" * 780
    with acquainted(service, usual, "Idempotency-Key: k") as connection:
        connection.sendall(head(usual, "Idempotency-Key: " + "k" * 180) + BODY)
        assert read(connection)[0] == 431


def test_a_silent_connection_ends_as_long_after_its_last_answer(
    there: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = protocols(monkeypatch)

    async def wait_is_over(silent_s: float) -> bool:
        """Say that its timer has run out, so long after the last answer; return whether it runs on."""
        made[0]._idle_s = made[0].loop.time() - silent_s
        made[0].timeout_keep_alive_handler()
        return made[0].timeout_keep_alive_task is not None

    with acquainted(there) as connection:
        assert there.run(wait_is_over(29))
        connection.sendall(head() + BODY)
        read(connection)
        assert there.run(wait_is_over(29))
        assert not there.run(wait_is_over(31))
        assert connection.recv(1) == b""


def test_a_timer_that_runs_out_under_an_answer_is_set_anew_behind_it(
    there: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    robots, made = there.runtime.robots, protocols(monkeypatch)
    observe = robots.observe

    async def late(*given: Any, **more: Any) -> Any:
        made[0]._idle_s -= 31
        made[0].timeout_keep_alive_handler()
        timers.append(made[0].timeout_keep_alive_task)
        return await observe(*given, **more)

    timers: list[Any] = []
    with acquainted(there) as connection:
        monkeypatch.setattr(robots, "observe", late)
        connection.sendall(head() + BODY)
        read(connection)
        assert timers == [None]
        until(lambda: made[0].timeout_keep_alive_task is not None, "no timer is set")


@dataclass
class HeldUp:
    """A batch with a known head that is under way until `goes_on` is set."""

    connection: socket.socket
    goes_on: threading.Event
    cancelled: threading.Event


@contextmanager
def held_up(service: Service, monkeypatch: pytest.MonkeyPatch) -> Iterator[HeldUp]:
    came, goes_on, cancelled = threading.Event(), threading.Event(), threading.Event()
    robots = service.runtime.robots
    usual = robots.observe

    async def observe(*given: Any, **more: Any) -> Any:
        came.set()
        try:
            while not goes_on.is_set():
                await anyio.sleep(0.001)
        except asyncio.CancelledError:
            cancelled.set()
            raise
        return await usual(*given, **more)

    with acquainted(service) as connection:
        monkeypatch.setattr(robots, "observe", observe)
        body = b'{"observations": ["ok(scan)"]}'
        connection.sendall(head(length=len(body)) + body)
        assert came.wait(30)
        yield HeldUp(connection, goes_on, cancelled)


def test_one_that_comes_while_another_is_under_way_waits(
    there: Service, parsed: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    with held_up(there, monkeypatch) as one:
        before = len(parsed)
        one.connection.sendall(head() + BODY)
        until(lambda: len(parsed) > before, "the second has not come")
        one.goes_on.set()
        first, second = (read(one.connection)[2]["revision"] for _ in range(2))
    assert second == first + 1


def test_a_batch_under_way_is_answered_before_the_service_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = Protocol.shutdown
    with ExitStack() as stack:
        with running(Settings(port=0, data=tmp_path)) as service:
            service.with_robot("direct")
            one = stack.enter_context(held_up(service, monkeypatch))

            def shutdown(self: Protocol) -> None:
                usual(self)
                one.goes_on.set()

            monkeypatch.setattr(Protocol, "shutdown", shutdown)
        status, headers, _ = read(one.connection)
        assert (status, headers["connection"]) == (200, "close")
        assert one.connection.recv(1) == b""


def test_a_batch_that_does_not_end_is_given_up_with_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ExitStack() as stack:
        with running(Settings(port=0, data=tmp_path, graceful_s=1)) as service:
            service.with_robot("direct")
            one = stack.enter_context(held_up(service, monkeypatch))
        assert one.cancelled.is_set()
