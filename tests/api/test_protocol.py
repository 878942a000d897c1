"""What comes before a request is one: endless, slow or no HTTP at all. Talked to through a bare socket."""

from __future__ import annotations

import json
import socket

import pytest
from tests.api.conftest import Service, StartService

HOST = b"Host: localhost\r\n"


def connect(service: Service) -> socket.socket:
    """Return a connection that gives up after 20 s."""
    return socket.create_connection(("127.0.0.1", int(service.url.rsplit(":", 1)[1])), timeout=20)


def rest(connection: socket.socket) -> bytes:
    """Return everything up to the end of the connection."""
    found = b""
    try:
        while chunk := connection.recv(65536):
            found += chunk
    except ConnectionResetError:  # what we sent beyond the limit was never read
        pass
    return found


def ask(service: Service, data: bytes) -> tuple[int, dict[str, object]]:
    """Send bytes and return the status and body of the only answer, after which the connection ends."""
    with connect(service) as connection:
        connection.sendall(data)
        head, _, body = rest(connection).partition(b"\r\n\r\n")
    assert b"content-type: application/problem+json" in head.lower()
    return int(head.split()[1]), json.loads(body)


@pytest.mark.parametrize(
    "data",
    [
        b"\x00\x01garbage\r\n\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"GET /healthz HTTP/1.1\r\n" + HOST + b"Host: evil.example\r\n\r\n",
        b"GET /\xff\xfe HTTP/1.1\r\n" + HOST + b"\r\n",
        b"POST /api/v1/stop HTTP/1.1\r\n" + HOST + b"Content-Length: -1\r\n\r\n",
        b"POST /api/v1/stop HTTP/1.1\r\n" + HOST + b"Content-Length: 2\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"POST /api/v1/stop HTTP/1.1\r\n" + HOST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n{}\r\n",
    ],
)
def test_what_is_no_http_is_a_problem(service: Service, data: bytes) -> None:
    status, body = ask(service, data)
    assert (status, body["code"]) == (400, "bad-request")


@pytest.mark.parametrize("line", [b"X: ", b"X" * 100 + b": y\r\n", b"GET /"], ids=["one", "many", "path"])
def test_an_endless_head_is_cut_off(service: Service, line: bytes) -> None:
    start = line if line.startswith(b"GET") else b"GET /healthz HTTP/1.1\r\n" + HOST + line
    more = line * 100 if line.endswith(b"\n") else b"a" * 10_000
    with connect(service) as connection:
        connection.sendall(start)
        sent = 0
        try:
            while sent < 50_000_000:
                connection.sendall(more)
                sent += len(more)
        except OSError:
            pass
        assert sent < 50_000_000


def test_a_head_beyond_the_limit_is_a_431(start: StartService) -> None:
    service = start(max_head_bytes=2000)
    whole = b"GET /healthz HTTP/1.1\r\n" + HOST + b"X: " + b"a" * 2000 + b"\r\n\r\n"
    status, body = ask(service, whole)
    assert (status, body["code"]) == (431, "headers-too-large")
    status, body = ask(service, whole[:2040])
    assert (status, body["code"]) == (431, "headers-too-large")
    assert service.http.get("/healthz", headers={"X": "a" * 1000}).status_code == 200


def test_a_head_that_does_not_end_is_given_up(start: StartService) -> None:
    service = start(head_timeout_s=1.0)
    status, body = ask(service, b"GET /healthz HTTP/1.1\r\n")
    assert (status, body["code"]) == (408, "request-timeout")


def test_a_second_head_that_does_not_end_is_given_up_too(start: StartService) -> None:
    service = start(head_timeout_s=1.0)
    with connect(service) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\n" + HOST + b"\r\n")
        answer = b""
        while not answer.endswith(b"}"):
            answer += connection.recv(65536)
        assert answer.startswith(b"HTTP/1.1 200")
        connection.sendall(b"GET /healthz")
        assert rest(connection).startswith(b"HTTP/1.1 408")


def test_a_connection_that_says_nothing_is_closed(start: StartService) -> None:
    service = start(head_timeout_s=1.0)
    with connect(service) as connection:
        assert rest(connection) == b""


def test_an_answer_may_take_longer_than_a_head(start: StartService) -> None:
    service = start(head_timeout_s=1.0)
    service.with_robot()
    service.observe("ok(scan)")
    assert service.diagnosis(wait_s=2.0, after=1)["revision"] == 1
    with service.http.stream("GET", "/api/v1/events") as stream:
        lines = stream.iter_lines()
        next(lines)
        assert service.diagnosis(wait_s=1.5, after=1)["revision"] == 1
        service.observe("not ok(scan)")
        assert any(line.startswith("event:") for line in lines)


def test_pipelined_requests_are_answered_in_order(service: Service) -> None:
    one = b"GET /healthz HTTP/1.1\r\n" + HOST + b"\r\n"
    last = b"GET /version-info HTTP/1.1\r\n" + HOST + b"Connection: close\r\n\r\n"
    with connect(service) as connection:
        connection.sendall(one * 50 + last)
        found = rest(connection)
    assert found.count(b"HTTP/1.1 200") == 51
    assert found.rindex(b'"status":"ok"') < found.index(b'"robomend"')
