"""JSON bodies, read strictly and within limits.

Python's own reader takes NaN, Infinity, lone surrogates and any depth. Each of these would travel on until
a part that cannot hold it (the database, a UTF-8 encoder, the recursion limit) fails far from its cause, so
they are refused here with their place.
"""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any, NoReturn

from robomend.errors import InputError, MalformedJson, TooDeep

if TYPE_CHECKING:  # a worker that reads JSON needs no more of the service than this
    from robomend.robots.readers import Readers

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
