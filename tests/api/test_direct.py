"""A plain batch is answered without a request of the server's; a client sees no difference."""

from __future__ import annotations

import json
import socket
import threading
from typing import Any

import pytest
from tests.api.conftest import Service
from tests.waiting import until

from robomend.api import batch_connection
from robomend.api.app import direct_way
from robomend.api.direct import Direct, Exchange
from robomend.api.protocol import Protocol
from robomend.api.views import AcceptedResponse
from robomend.logs import PRINCIPAL, REQUEST

HOST = "Host: localhost\r\n"
JSON = "Content-Type: application/json\r\n"
BODY = b'{"observations": ["not ok(scan)"]}'


@pytest.fixture
def answered(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The bodies that were answered directly."""
    bodies: list[bytes] = []
    usual = Direct.answer

    async def answer(self: Direct, scope: Any, body: bytes) -> Any:
        bodies.append(body)
        return await usual(self, scope, body)

    monkeypatch.setattr(Direct, "answer", answer)
    return bodies


def connect(service: Service) -> socket.socket:
    return socket.create_connection(("127.0.0.1", int(service.url.rsplit(":", 1)[1])), timeout=30)


def head(*more: str, length: int = len(BODY), robot: str = "direct", version: str = "1.1") -> bytes:
    first = f"POST /api/v1/robots/{robot}/observations HTTP/{version}\r\n{HOST}{JSON}"
    rest = "".join(f"{line}\r\n" for line in more)
    return f"{first}Content-Length: {length}\r\n{rest}\r\n".encode()


def read(connection: socket.socket) -> tuple[int, dict[str, str], dict[str, Any]]:
    """Return status, headers and body of one answer."""
    found = b""
    while b"\r\n\r\n" not in found:
        found += _some(connection)
    first, _, rest = found.partition(b"\r\n\r\n")
    status, *lines = first.decode().split("\r\n")
    headers = {name.lower(): value for name, value in (line.split(": ", 1) for line in lines)}
    while len(rest) < int(headers["content-length"]):
        rest += _some(connection)
    assert len(rest) == int(headers["content-length"])
    return int(status.split()[1]), headers, json.loads(rest)


def _some(connection: socket.socket) -> bytes:
    data = connection.recv(65536)
    assert data, "the connection ended"
    return data


def ask(service: Service, data: bytes) -> tuple[int, dict[str, str], dict[str, Any]]:
    with connect(service) as connection:
        connection.sendall(data)
        return read(connection)


@pytest.mark.parametrize("robot", ["direct", "nobody"])
def test_an_answer_has_the_headers_of_any_other(there: Service, answered: list[bytes], robot: str) -> None:
    direct = ask(there, head(robot=robot) + BODY)
    usual = ask(there, head("X-Other: 1", robot=robot) + BODY)
    assert answered == [BODY]
    assert direct[0] == usual[0]
    own = {"x-request-id", "date", "ratelimit", "content-length"}  # another each time
    assert list(direct[1]) == list(usual[1])
    assert {n: v for n, v in direct[1].items() if n not in own} == {
        n: v for n, v in usual[1].items() if n not in own
    }
    assert direct[2].keys() == usual[2].keys()


@pytest.mark.parametrize(
    "more", ["Cookie: a=b", "Origin: http://localhost", "Expect: 100-continue", "Content-Encoding: gzip"]
)
def test_whatever_may_mean_something_goes_the_usual_way(
    there: Service, answered: list[bytes], more: str
) -> None:
    with connect(there) as connection:
        connection.sendall(head(more) + BODY)
        assert connection.recv(12).startswith(b"HTTP/1.1 ")
    assert answered == []


def test_a_body_that_comes_behind_its_head_is_waited_for(there: Service, answered: list[bytes]) -> None:
    with connect(there) as connection:
        for piece in (head(), BODY[:7], BODY[7:]):
            connection.sendall(piece)
        assert read(connection)[0] == 200
        connection.sendall(head() + BODY)  # and the connection is as good as before
        assert read(connection)[0] == 200
    assert BODY in answered


def test_a_body_that_takes_longer_is_watched_like_any_other(
    there: Service, answered: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch_connection, "MOMENT_S", 0.0)
    begun = threading.Event()
    usual = Protocol._begin_as_usual

    def begin(self: Protocol) -> None:
        usual(self)
        begun.set()

    monkeypatch.setattr(Protocol, "_begin_as_usual", begin)
    with connect(there) as connection:
        connection.sendall(head("Idempotency-Key: late") + BODY[:5])
        assert begun.wait(30)
        connection.sendall(BODY[5:])
        assert read(connection)[0] == 200
    assert answered == []


def test_requests_in_a_row_are_answered_in_their_order(there: Service, answered: list[bytes]) -> None:
    wanted = [BODY, b'{"observations": ["ok(scan)"]}', b"{}", BODY]
    with connect(there) as connection:
        connection.sendall(b"".join(head(length=len(body)) + body for body in wanted))
        answers = [read_one(connection) for _ in wanted]
    assert [status for status, _ in answers] == [200] * 4
    revisions = [said["revision"] for _, said in answers]
    assert revisions == sorted(revisions)
    assert answered[:1] == [BODY]


def read_one(connection: socket.socket) -> tuple[int, dict[str, Any]]:
    """Read one of several answers, byte by byte up to its body."""
    found = b""
    while not found.endswith(b"\r\n\r\n"):
        byte = connection.recv(1)
        assert byte, "the connection ended"
        found += byte
    lines = found.decode().lower().split("\r\n")
    length = next(int(line.split(": ")[1]) for line in lines if line.startswith("content-length"))
    body = b""
    while len(body) < length:
        body += _one_more(connection, length - len(body))
    return int(lines[0].split()[1]), json.loads(body)


def _one_more(connection: socket.socket, most: int) -> bytes:
    data = connection.recv(most)
    assert data, "the connection ended"
    return data


def test_who_wants_the_connection_closed_gets_it_closed(there: Service, answered: list[bytes]) -> None:
    with connect(there) as connection:
        connection.sendall(head("Connection: close") + BODY)
        status, headers, _ = read(connection)
        assert (status, headers["connection"]) == (200, "close")
        assert connection.recv(1) == b""
    assert answered == [BODY]


def test_what_is_the_same_in_all_answers_is_made_anew_when_it_changes(there: Service) -> None:
    direct = direct_way(there.runtime.app, there.runtime.settings)
    response, scope = AcceptedResponse(b"{}"), {"robomend.request_id": "a"}
    for date in (b"today", b"tomorrow"):
        usual = [(b"date", date)]
        told = direct.text(response, scope, Exchange(keep_alive=True), usual)
        closing = direct.text(response, scope, Exchange(keep_alive=False), usual)
        assert b"date: " + date + b"\r\n" in told
        assert closing == told.replace(b"\r\n\r\n", b"\r\nconnection: close\r\n\r\n")


def test_a_bug_is_answered_with_500_and_told(
    there: Service, answered: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(*_: Any, **__: Any) -> Any:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(there.runtime.robots, "observe", fail)
    status, _, body = ask(there, head() + BODY)
    assert (status, body["code"]) == (500, "internal")
    assert answered == [BODY]


def test_the_log_names_each_request_and_who_makes_it(there: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    robots = there.runtime.robots
    usual, seen = robots.observe, list[tuple[str | None, str | None]]()

    async def observe(*given: Any, **more: Any) -> Any:
        outcome = await usual(*given, **more)
        seen.append((REQUEST.get(), PRINCIPAL.get()))
        return outcome

    monkeypatch.setattr(robots, "observe", observe)
    told = []
    with connect(there) as connection:
        for more in ((), (), (), ("X-Request-ID: mine",), ("X-Other: 1",)):
            connection.sendall(head(*more) + BODY)
            told.append((read(connection)[1]["x-request-id"], "local"))
    assert seen == told
    assert len(set(seen)) == 5
    assert told[3] == ("mine", "local")


def test_who_goes_away_before_the_answer_harms_nobody(there: Service, answered: list[bytes]) -> None:
    with connect(there) as connection:
        connection.sendall(head() + BODY)
    until(lambda: answered == [BODY], "it was not taken")
    assert ask(there, head() + BODY)[0] == 200
