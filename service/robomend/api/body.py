"""Request bodies: how large, how slow, in which form.

A body is cut off as soon as it is larger than allowed, whether or not it says so itself (413), and given up
when nothing comes for a while (408): a client that sends a byte a minute must not hold memory for ever.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, NoReturn

from starlette.requests import ClientDisconnect, Request
from starlette.types import Receive

from robomend.api.problems import Problem
from robomend.errors import InputError, MalformedJson, TooDeep
from robomend.robots.readers import Readers
from robomend.settings import Settings

# --- requests that take longer than a key is known to be good end with it, and with their client
#
#     a body that comes slowly     looked at while it comes, before anything is done with it (read_chunks)
#     a long poll                  looked at while it waits (`while_admitted`)
#     a stream of events           looks for itself (robomend.api.streams)
#
# A long poll whose client is gone would keep its place among those that may wait (`max_waiters`): when a
# network comes back, a whole fleet asks anew, and must not be refused because of its own former questions.
#
# The gate leaves in the request's scope how it is asked again.

AGAIN = "robomend.admit_again"
"""In a scope: a function that raises the Problem which a request with this scope has become."""

Again = Callable[[Request], Awaitable[object]]

LOOK_S = 2.0
"""Between two looks."""


async def look_again(request: Request) -> None:
    """Return if whoever was let in would be let in now. Problem (401): the key was revoked meanwhile."""
    again: Again | None = request.scope.get(AGAIN)
    if again is not None:
        await again(request)


@asynccontextmanager
async def while_admitted(request: Request) -> AsyncIterator[None]:
    """Cut off the wait in the block when its key is revoked, or its client is gone.

    Raises:
        Problem: 401, the answer then.
        ClientDisconnect: there is nobody to answer.
    """
    waiting = asyncio.current_task()
    assert waiting is not None
    ends: list[Exception] = []

    async def look() -> None:
        leaving = asyncio.ensure_future(left(request.receive))
        try:
            while not (await asyncio.wait({leaving}, timeout=LOOK_S))[0]:
                await look_again(request)
            ends.append(ClientDisconnect())
        except Problem as problem:
            ends.append(problem)
        finally:
            leaving.cancel()
        waiting.cancel()

    looking = asyncio.create_task(look(), name="still admitted")
    try:
        yield
    except asyncio.CancelledError:
        if ends and waiting.uncancel() == 0:
            raise ends[0] from None
        raise
    finally:
        looking.cancel()


async def left(receive: Receive) -> None:
    """Return when the client of a request has gone away."""
    while (await receive())["type"] != "http.disconnect":
        pass


# --- JSON bodies, read strictly and within limits
# Python's own reader takes NaN, Infinity, lone surrogates and any depth. Each of these would travel on until
# a part that cannot hold it (the database, a UTF-8 encoder, the recursion limit) fails far from its cause, so
# they are refused here with their place.

MAX_DIGITS = 40
"""Of one integer; nothing here needs more than the 19 of a time in nanoseconds."""

AT_ONCE = 64 << 10
"""Bytes that are read on the event loop: a few milliseconds, whatever they say."""

MAX_VALUES = 100_000
"""In a longer text; a batch has at most 10,000 sentences."""


def _refuse_constant(name: str) -> NoReturn:
    raise MalformedJson(f"the body is not JSON: {name} is no JSON number")


def _read_integer(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise InputError(f"the body has an integer of {len(digits)} digits; at most {MAX_DIGITS} are read")
    return int(digits)


def _read_float(text: str) -> float:
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise InputError(f"the body has a number beyond the range of a double: {text[:40]}")
    return value


def _read_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) < len(pairs):  # which of the two was meant?
        [(twice, _)] = Counter(name for name, _ in pairs).most_common(1)
        raise MalformedJson(f"the body has the key {twice[:100]!r} twice in one object")
    return value


_decoder = json.JSONDecoder(
    parse_constant=_refuse_constant,
    parse_int=_read_integer,
    parse_float=_read_float,
    object_pairs_hook=_read_object,
    strict=True,
)


def loads(body: bytes, max_nesting: int) -> Any:
    """Return the value of a JSON text.

    Raises:
        MalformedJson: it is not JSON in UTF-8, or an object has a key twice.
        TooDeep: it is nested deeper than `max_nesting`.
        InputError: it holds what nothing here could store, or more values than any request needs.
    """
    try:
        text = body.decode("utf-8")
    except UnicodeDecodeError as error:
        raise MalformedJson(
            f"the body is not UTF-8: byte {error.start} is {body[error.start]:#04x}"
        ) from error
    check_nesting(text, max_nesting)
    try:
        value = _decoded(text)
    except json.JSONDecodeError as error:
        raise MalformedJson(
            f"the body is not JSON: {error.msg} at line {error.lineno}, column {error.colno}"
        ) from error
    if "\\u" in text:
        _check_escapes(value)
    if len(body) > AT_ONCE:
        _check_count(value)
    return value


def _decoded(text: str) -> Any:
    if text.startswith(("{", "[")):  # nearly always, and with nothing behind it
        value, end = _decoder.raw_decode(text)
        if end == len(text):
            return value
    return _decoder.decode(text)


async def loads_in_turn(body: bytes, max_nesting: int, readers: Readers) -> Any:
    """Return the value of a JSON text without keeping others waiting: a long one is read in a worker."""
    if len(body) <= AT_ONCE:
        return loads(body, max_nesting)
    return await readers.call(loads, body, max_nesting)


def _check_count(value: Any) -> None:
    """Refuse a value that takes long to hand on: it came a long way in a few bytes a piece."""
    count, left = 0, [value]
    while left:
        item = left.pop()
        inner = item if isinstance(item, list) else [*item, *item.values()] if isinstance(item, dict) else ()
        count += 1
        left.extend(inner)
    if count > MAX_VALUES:
        raise InputError(f"the body has {count:,} values; at most {MAX_VALUES:,} are read")


def check_nesting(text: str, most: int) -> None:
    """Refuse a text nested deeper than `most` before the recursive reader meets it.

    Brackets within strings count too where there are many: only a text with more than `most` opening
    brackets is looked at closely.
    """
    if text.count("[") + text.count("{") <= most:
        return
    depth = 0
    in_string = escaped = False
    for char in text:
        if in_string:
            if escaped:
                escaped = False
            elif char == "\\":
                escaped = True
            elif char == '"':
                in_string = False
        elif char == '"':
            in_string = True
        elif char in "[{":
            depth += 1
            if depth > most:
                raise TooDeep(f"the body is nested deeper than {most}")
        elif char in "]}":
            depth -= 1


def _check_escapes(value: Any) -> None:
    """Refuse what only an escape can bring in: half a surrogate pair,
    and NUL, which PostgreSQL cannot store.
    """
    if isinstance(value, str):
        if "\x00" in value:
            raise InputError("the body has the character NUL in a string")
        try:
            value.encode("utf-8")
        except UnicodeEncodeError as error:
            raise InputError("the body has half a surrogate pair in a string") from error
    elif isinstance(value, list):
        for item in value:
            _check_escapes(item)
    elif isinstance(value, dict):
        for name, item in value.items():
            _check_escapes(name)
            _check_escapes(item)


BYTES_PER_S = 4096.0
"""Of a JSON body or a model, on average, after the first pause; a slower link sends NDJSON."""


class StrictRequest(Request):
    """A request whose JSON body was read with limits; see the module."""

    def __init__(self, request: Request, settings: Settings, readers: Readers) -> None:
        super().__init__(request.scope, request.receive)
        self._settings = settings
        self._readers = readers
        self._bytes = b""
        self._value: Any = None

    async def read(self, limit: int, timeout_s: float | None = None) -> None:
        """Read and parse the body, before the framework asks for it:
        it would take our Problems for its own.
        """
        timeout_s = timeout_s or self._settings.body_timeout_s
        chunks = [chunk async for chunk in read_chunks(self, limit, timeout_s, BYTES_PER_S)]
        self._bytes = b"".join(chunks)
        if self._bytes:
            check_content_type(self, "application/json")
            self._value = await loads_in_turn(self._bytes, self._settings.max_nesting, self._readers)

    async def body(self) -> bytes:
        return self._bytes

    async def json(self) -> Any:
        return self._value


def content_type(request: Request) -> str:
    """Return the media type of the body without its parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def check_encoding(request: Request) -> None:
    """Refuse a compressed body with 415: a kilobyte may unfold into a gigabyte."""
    encoding = request.headers.get("content-encoding", "identity")
    if encoding.strip().lower() != "identity":
        raise Problem(
            415,
            f"the body is encoded as {encoding[:40]!r}; it is taken as it is only",
            headers={"Accept-Encoding": "identity"},
        )


def check_content_type(request: Request, *allowed: str) -> None:
    """Refuse a body of another kind with 415."""
    if content_type(request) not in allowed:
        given = request.headers.get("content-type", "")[:100] or "no content type"
        raise Problem(415, f"the body must be {' or '.join(allowed)}, not {given}")


async def read_chunks(
    request: Request, limit: int, timeout_s: float, bytes_per_s: float | None = None
) -> AsyncIterator[bytes]:
    """Yield a body as it comes, up to `limit` bytes.

    Args:
        timeout_s: the longest pause.
        bytes_per_s: if given, what it must come to on average, after the first `timeout_s`.

    Raises:
        Problem: 413 when there is more, 408 when it stalls, 415 when it is compressed, 401 when its key was
            revoked meanwhile.
        ClientDisconnect: the client went away in the middle.
    """
    check_encoding(request)
    declared = request.headers.get("content-length")
    if declared is not None and declared.isdigit() and int(declared[:20]) > limit:
        raise Problem(
            413, f"the body has {declared} bytes; at most {limit} are taken", headers={"Connection": "close"}
        )
    size = 0
    more = True
    began = looked = time.monotonic()
    while more:
        wait_s = timeout_s
        if bytes_per_s is not None:
            wait_s = min(wait_s, began + timeout_s + size / bytes_per_s - time.monotonic())
        try:
            async with asyncio.timeout(wait_s):
                message = await request.receive()
        except TimeoutError as error:
            slow = f"the body came too slowly: {size} bytes in {time.monotonic() - began:.0f} s"
            raise Problem(408, slow, headers={"Connection": "close"}) from error
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        if time.monotonic() - looked > LOOK_S:
            await look_again(request)
            looked = time.monotonic()
        chunk = message.get("body", b"")
        more = message.get("more_body", False)
        size += len(chunk)
        if size > limit:
            raise Problem(413, f"the body has more than {limit} bytes", headers={"Connection": "close"})
        if chunk:
            yield chunk
