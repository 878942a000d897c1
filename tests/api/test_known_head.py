"""What is read by a known head is what the parser finds, and any other difference is left to the parser."""

from __future__ import annotations

from typing import Any

import httptools
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.api.test_direct import BODY

from robomend.api.known_head import KnownHead
from robomend.api.origin import by_name

PATH = b"/api/v1/robots/r1/observations"


class Parsed:
    """The first request in some bytes, as the parser of the connections finds it."""

    def __init__(self, data: bytes) -> None:
        self.url, self.headers, self.body = b"", list[tuple[bytes, bytes]](), b""
        self.complete = self.malformed = self.known = False
        self._parser = httptools.HttpRequestParser(self)
        try:
            self._parser.feed_data(data)
        except httptools.HttpParserError:
            self.malformed = True

    def on_url(self, url: bytes) -> None:
        self.url += url

    def on_header(self, name: bytes, value: bytes) -> None:
        self.headers.append((name.lower(), value))

    def on_body(self, body: bytes) -> None:
        self.body += body

    def on_message_complete(self) -> None:
        self.complete = True

    @property
    def scope(self) -> dict[str, Any]:
        return {"raw_path": self.url, "headers": self.headers}


def known(data: bytes) -> KnownHead | None:
    scope = Parsed(data).scope
    by_name(scope)  # as whoever finds that it is a plain batch has done
    return KnownHead.of(data, scope)


NAMES = st.sampled_from(
    [
        "Accept",
        "accept-encoding",
        "Authorization",
        "Connection",
        "USER-AGENT",
        "X-Request-Id",
        "Idempotency-Key",
    ]
)
VALUES = st.sampled_from(
    ["keep-alive", "Bearer rm_0", "a", "k-1", "two words", "", " a", "a\t", "\xe9", "1" * 201]
)
LINES = st.lists(st.tuples(NAMES, VALUES), max_size=5)


def request(lines: list[tuple[str, str]], body: bytes, length: str = "Content-Length") -> bytes:
    told = [("Host", "localhost"), *lines, ("Content-Type", "application/json"), (length, str(len(body)))]
    text = "".join(f"{name}: {value}\r\n" for name, value in told)
    return b"POST " + PATH + b" HTTP/1.1\r\n" + text.encode("latin-1") + b"\r\n" + body


@example([("X-Request-Id", "a"), ("X-Request-Id", "keep-alive")], [], b"", b"\0", 0)
@given(LINES, LINES, st.binary(max_size=30), st.binary(min_size=1, max_size=3), st.integers(0, 300))
def test_what_is_read_by_a_known_head_is_what_the_parser_finds(
    lines: list[tuple[str, str]], others: list[tuple[str, str]], body: bytes, noise: bytes, at: int
) -> None:
    first = known(request(lines, b"{}"))
    values = dict(others)
    varied = [(name, values.get(name, value)) for name, value in lines]
    whole = request(varied, body)
    for data in (whole, whole[:at] + noise + whole[at:], whole[:at] + noise + whole[at + len(noise) :]):
        found = None if first is None else first.read(data)
        if found is None:
            continue
        scope, head_bytes, length = found
        parsed = Parsed(data[: head_bytes + length])
        assert not parsed.malformed
        assert (scope["raw_path"], scope["headers"]) == (parsed.url, parsed.headers)
        assert by_name(scope) == dict(reversed(parsed.headers))
        assert parsed.complete == (len(data) >= head_bytes + length)
        assert data[head_bytes : head_bytes + length] == parsed.body


def test_an_observers_next_head_is_known_whatever_its_length_and_keys() -> None:
    first = known(
        request([("Idempotency-Key", "k-1"), ("X-Request-ID", "a"), ("Authorization", "Bearer b")], BODY)
    )
    assert first is not None
    more = request([("Idempotency-Key", "k-22"), ("X-Request-ID", "c"), ("Authorization", "Bearer b")], b"[]")
    found = first.read(more)
    assert found is not None
    scope, head_bytes, length = found
    assert more[head_bytes:] == b"[]"
    assert length == 2
    assert dict(scope["headers"])[b"idempotency-key"] == b"k-22"
    assert by_name(scope)[b"x-request-id"] == b"c"


@pytest.mark.parametrize(
    "other",
    [
        request([("Authorization", "Bearer c")], BODY),
        request([("Authorization", "Bearer b"), ("Cookie", "a=b")], BODY),
        request([("authorization", "Bearer b")], BODY),
        request([("Authorization", "Bearer b")], BODY).replace(b"/r1/", b"/r2/"),
        request([("Authorization", "Bearer b")], BODY).replace(b"Length: 34", b"Length: +34"),
        request([("Authorization", "Bearer b")], BODY).replace(b"Length: 34", b"Length: 34, 34"),
        request([("Authorization", "Bearer b")], BODY).replace(b"Length: 34", b"Length: 0000034"),
        request([("Authorization", "Bearer b")], BODY).replace(b"Length: 34\r\n", b"Length: 34\n"),
        b"\r\n" + request([("Authorization", "Bearer b")], BODY),
    ],
)
def test_any_other_difference_is_left_to_the_parser(other: bytes) -> None:
    first = known(request([("Authorization", "Bearer b")], BODY))
    assert first is not None
    assert first.read(other) is None


def test_of_a_connection_that_is_about_to_end_nothing_is_remembered() -> None:
    assert known(request([("Connection", "keep-alive")], BODY)) is not None
    assert known(request([("Connection", "close")], BODY)) is None
