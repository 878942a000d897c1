"""What comes before a request is one: endless, slow or no HTTP at all. Talked to through a bare socket."""

from __future__ import annotations

import contextlib
import gzip
import json
import socket
from typing import Any

import pytest
from structlog.testing import capture_logs
from tests.api.conftest import Service, StartService
from tests.waiting import until

from robomend.api import edge
from robomend.api.protocol import HEADERS

HOST = b"Host: localhost\r\n"


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
    with service.connect() as connection:
        connection.sendall(data)
        head, _, body = rest(connection).partition(b"\r\n\r\n")
    assert b"content-type: application/problem+json" in head.lower()
    return int(head.split()[1]), json.loads(body)


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Connections whose answer was given are kept for a moment only."""
    for name in ("protocol.REST_S", "protocol.LINGER_S", "edge.LINGER_S"):
        monkeypatch.setattr(f"robomend.api.{name}", 0.2)


POST = b"POST /api/v1/stop HTTP/1.1\r\n" + HOST


@pytest.mark.parametrize(
    ("data", "status", "code"),
    [
        (b"\x00\x01garbage\r\n\r\n", 400, "bad-request"),
        (b"GET /version-info HTTP/1.1\r\n" + HOST + b"Host: evil.example\r\n\r\n", 400, "bad-request"),
        (b"GET /\xff\xfe HTTP/1.1\r\n" + HOST + b"\r\n", 400, "bad-request"),
        (POST + b"Content-Length: -1\r\n\r\n", 400, "bad-request"),
        (POST + b"Content-Length: 2\r\nTransfer-Encoding: chunked\r\n\r\n", 400, "bad-request"),
        (POST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n{}\r\n", 400, "bad-request"),
        (POST + b"Transfer-Encoding: gzip, chunked\r\n\r\n", 400, "bad-request"),
        (POST.replace(b"/1.1", b"/1.0") + b"Transfer-Encoding: chunked\r\n\r\n", 400, "bad-request"),
        (b"GET /version-info HTTP/1.1\r\n\r\n", 400, "bad-request"),  # no Host
        (b"\r\n" * 50_000, 400, "bad-request"),
        (b"GET /version-info HTTP/2.0\r\n" + HOST + b"\r\n", 505, "http-version"),
        (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", 505, "http-version"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_what_is_no_http_1_1_is_a_problem(service: Service, data: bytes, status: int, code: str) -> None:
    found, body = ask(service, data)
    assert (found, body["code"]) == (status, code)


@pytest.mark.parametrize("line", [b"X: ", b"X" * 100 + b": y\r\n", b"GET /"], ids=["one", "many", "path"])
def test_an_endless_head_is_cut_off(service: Service, line: bytes) -> None:
    start = line if line.startswith(b"GET") else b"GET /version-info HTTP/1.1\r\n" + HOST + line
    more = line * 100 if line.endswith(b"\n") else b"a" * 10_000
    with service.connect() as connection:
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
    whole = b"GET /version-info HTTP/1.1\r\n" + HOST + b"X: " + b"a" * 2000 + b"\r\n\r\n"
    status, body = ask(service, whole)
    assert (status, body["code"]) == (431, "headers-too-large")
    status, body = ask(service, whole[:2040])
    assert (status, body["code"]) == (431, "headers-too-large")
    assert service.http.get("/version-info", headers={"X": "a" * 1000}).status_code == 200


def test_a_head_that_does_not_end_is_given_up(start: StartService) -> None:
    service = start(head_timeout_s=1.5)
    status, body = ask(service, b"GET /version-info HTTP/1.1\r\n")
    assert (status, body["code"]) == (408, "request-timeout")
    with service.connect() as connection:  # the second of a connection, too
        connection.sendall(b"GET /version-info HTTP/1.1\r\n" + HOST + b"\r\n")
        answer = b""
        while not answer.endswith(b"}"):
            more = connection.recv(65536)
            assert more, answer
            answer += more
        assert answer.startswith(b"HTTP/1.1 200")
        connection.sendall(b"GET /version-info")
        assert rest(connection).startswith(b"HTTP/1.1 408")
    with service.connect() as connection:  # and one that says nothing is closed
        assert rest(connection) == b""


def test_an_answer_may_take_longer_than_a_head(start: StartService) -> None:
    service = start(head_timeout_s=1.0)
    service.with_robot()
    service.observe("ok(scan)")
    assert service.diagnosis(wait_s=1.5, after=1)["revision"] == 1
    with service.http.stream("GET", "/api/v1/events") as stream:
        lines = stream.iter_lines()
        next(lines)
        assert service.diagnosis(wait_s=1.5, after=1)["revision"] == 1
        service.observe("not ok(scan)")
        assert any(line.startswith("event:") for line in lines)


def test_pipelined_requests_are_answered_in_order(service: Service) -> None:
    one = b"GET /api/v1/robots HTTP/1.1\r\n" + HOST + b"\r\n"
    last = b"GET /version-info HTTP/1.1\r\n" + HOST + b"Connection: close\r\n\r\n"
    with service.connect() as connection:
        connection.sendall(one * 300 + last)
        found = rest(connection)
    assert found.count(b"HTTP/1.1 200") == 301
    assert found.rindex(b'"items"') < found.index(b'"robomend"')


STOP = POST + b"Content-Type: application/json\r\nContent-Length: 14\r\n\r\n"
LIST = b"GET /api/v1/robots HTTP/1.1\r\n" + HOST + b"\r\n"
BROKEN_BODY = b"PUT /api/v1/robots/r9 HTTP/1.1\r\n" + HOST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n"


@pytest.mark.parametrize("behind", [b"garbage garbage\r\n\r\n", b"GET /" + b"x" * 70_000, BROKEN_BODY])
@pytest.mark.parametrize("whole", [STOP + b'{"reason":"x"}', LIST, LIST * 3], ids=["stop", "list", "lists"])
def test_what_is_refused_takes_no_whole_request_before_it_along(
    service: Service, whole: bytes, behind: bytes
) -> None:
    with service.connect() as connection:
        connection.sendall(whole + behind)
        found = rest(connection)
    taken = found.count(b"HTTP/1.1 200") + found.count(b"HTTP/1.1 202")  # a stop may not be on disk yet
    assert taken == max(1, whole.count(b"GET "))
    # What is refused has its own answer behind theirs; the stop's ends the connection.
    assert found.count(b"HTTP/1.1 4") == found.count(b"HTTP/1.1 ") - taken == (not whole.startswith(STOP))
    if whole.startswith(STOP):
        assert service.api("GET", "/stop").json()["active"]


@pytest.mark.parametrize("framing", ["Content-Length: 10000000", "Transfer-Encoding: chunked"])
def test_the_answer_to_a_body_that_is_too_large_can_be_read(
    start: StartService, framing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robomend.api.edge.LINGER_S", 60.0)  # until all of it is read, or it resets
    service = start(max_body_bytes=2000, max_model_bytes=3000)
    head = b"POST /api/v1/robots/r1/observations HTTP/1.1\r\n" + HOST + b"Content-Type: application/json\r\n"
    body = b"a" * 10_000_000
    if "chunked" in framing:
        body = b"".join(b"2710\r\n" + b"a" * 10_000 + b"\r\n" for _ in range(1000)) + b"0\r\n\r\n"
    with service.connect() as connection:
        connection.sendall(head + framing.encode() + b"\r\n\r\n" + body)
        found = b"".join(iter(lambda: connection.recv(65536), b""))  # a reset would raise
    assert found.startswith(b"HTTP/1.1 413")
    assert b'"code": "too-large"' in found


@pytest.mark.parametrize(
    "wire",
    [
        b"GET /version-info HTTP/1.0\r\n\r\n",  # it needs no Host
        b"\r\nGET /version-info HTTP/1.1\r\n" + HOST + b"Connection: close\r\n\r\n",
    ],
    ids=["HTTP/1.0", "an empty line before it"],
)
def test_what_the_standard_allows_is_answered(service: Service, wire: bytes) -> None:
    with service.connect() as connection:
        connection.sendall(wire)
        assert rest(connection).startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize("before", [b"", b"2\r\n{}\r\n"], ids=["at once", "after a chunk"])
def test_trailers_are_bounded_and_end_with_their_answer(service: Service, before: bytes) -> None:
    """Without a key: the answer comes before the trailers do."""
    head = b"POST /api/v1/nothing HTTP/1.1\r\n" + HOST + b"Transfer-Encoding: chunked\r\n\r\n"
    trailer = b"X-Filler: " + b"a" * 1000 + b"\r\n"
    with service.connect() as connection:
        connection.sendall(head + before + b"0\r\n")
        sent = 0
        with contextlib.suppress(OSError):
            while sent < 100_000_000:
                connection.sendall(trailer)
                sent += len(trailer)
    assert sent < 30_000_000


def test_what_a_body_brings_besides_itself_is_bounded(service: Service) -> None:
    """Chunk extensions and trailers of a request that waits for its body."""
    service.with_robot("r1")
    head = b"POST /api/v1/robots/r1/observations HTTP/1.1\r\n" + HOST
    head += b"Content-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"
    with service.connect() as connection:
        connection.sendall(head + b"2;" + b"a=b;" * 30_000)
        assert rest(connection).startswith(b"HTTP/1.1 431")


def test_a_body_that_goes_on_after_its_answer_ends_with_its_time(service: Service) -> None:
    head = b"POST /api/v1/nothing HTTP/1.1\r\n" + HOST + b"Content-Length: 1000\r\n\r\n"
    with service.connect() as connection:
        connection.sendall(head)
        assert connection.recv(65536).startswith(b"HTTP/1.1 404")
        with contextlib.suppress(OSError):
            while connection.recv(65536):
                pass
            connection.sendall(b"a")


def test_a_body_that_drips_is_given_up(start: StartService) -> None:
    service = start(body_timeout_s=0.3)
    service.with_robot("r1")
    head = b"POST /api/v1/robots/r1/observations HTTP/1.1\r\n" + HOST
    head += b"Content-Type: application/json\r\nContent-Length: 1000\r\n\r\n"
    with service.connect() as connection:
        connection.sendall(head)
        found = b""
        while not found:
            connection.sendall(b" ")
            connection.settimeout(0.1)
            with contextlib.suppress(TimeoutError):
                found = connection.recv(65536)
    assert found.startswith(b"HTTP/1.1 408")


def test_a_compressed_body_is_a_415(service: Service) -> None:
    service.with_robot("r2")
    body = gzip.compress(b'{"observations": ["ok(scan)"]}')
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    answer = service.api("POST", "/robots/r2/observations", content=body, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (415, "unsupported-media-type")
    assert answer.headers["accept-encoding"] == "identity"


def test_of_requests_in_a_row_one_is_taken_up_at_a_time(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those behind it wait as they came: they cost no more memory than a connection's buffer."""
    begun: list[str] = []
    usual = edge.Edge.__call__

    async def counted(self: edge.Edge, scope: Any, receive: Any, send: Any) -> None:
        begun.append("begins")
        await usual(self, scope, receive, send)
        begun.append("ends")

    monkeypatch.setattr(edge.Edge, "__call__", counted)
    one = b"GET /version-info HTTP/1.1\r\n" + HOST
    with service.connect() as connection:
        connection.sendall((one + b"\r\n") * 1000 + one + b"Connection: close\r\n\r\n")
        assert rest(connection).count(b"HTTP/1.1 200") == 1001
    assert begun == ["begins", "ends"] * 1001


UPGRADE = b"Connection: Upgrade, keep-alive\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"


@pytest.mark.parametrize("kind", [UPGRADE, UPGRADE.replace(b"websocket", b"h2c")], ids=["websocket", "h2c"])
def test_an_upgrade_is_a_plain_request_and_what_follows_it_is_answered(service: Service, kind: bytes) -> None:
    with service.connect() as connection:
        first = b"GET /version-info HTTP/1.1\r\n" + HOST + kind + b"\r\n"
        connection.sendall(
            first + STOP.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n") + b'{"reason":"u"}'
        )
        found = rest(connection)
    assert found.count(b"HTTP/1.1 20") == found.count(b"HTTP/1.1 ") == 2
    assert found.index(b'"robomend"') < found.index(b'"active"')
    assert service.api("GET", "/stop").json()["reason"] == "u"


@pytest.mark.parametrize("path", [b"/version-info", b"/healthz"])
def test_more_headers_than_anybody_needs_are_a_431(service: Service, path: bytes) -> None:
    line = b"GET " + path + b" HTTP/1.1\r\n" + HOST
    few, many = (b"a:b\r\n" * count for count in (HEADERS // 2, HEADERS))
    with service.connect() as connection:
        connection.sendall(line + few + b"Connection: close\r\n\r\n")
        assert rest(connection).startswith(b"HTTP/1.1 200")
    status, body = ask(service, line + many + b"\r\n")
    assert (status, body["code"]) == (431, "headers-too-large")


def test_an_answer_that_comes_after_the_end_is_no_fault_of_ours(
    service: Service, caplog: pytest.LogCaptureFixture
) -> None:
    """Whoever floods must not fill the log with tracebacks besides."""
    with capture_logs() as told:
        with service.connect() as connection:
            line = b"POST /api/v1/nothing HTTP/1.1\r\n" + HOST + b"Transfer-Encoding: chunked\r\n\r\n0\r\n"
            connection.sendall(line + b"a: b\r\n" * 40_000)  # trailers; what is asked for is answered later
            assert rest(connection).startswith(b"HTTP/1.1 4")
        until(lambda: any(line.get("path") == "/api/v1/nothing" for line in told), "it is not in the log")
    assert [line for line in told if line["log_level"] not in {"info", "warning"} or "exc_info" in line] == []
    assert "Traceback" not in caplog.text


def test_a_strangers_body_is_small(service: Service) -> None:
    answer = service.api("POST", "/session", json={"key": "x" * 10_000})
    assert (answer.status_code, answer.json()["code"]) == (413, "too-large")
