"""Times for people and for programs without 64-bit integers: RFC 3339, in UTC, to the millisecond."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, overload


@overload
def rfc3339(time_ns: int) -> str: ...
@overload
def rfc3339(time_ns: None) -> None: ...
def rfc3339(time_ns: int | None) -> str | None:
    """Return a time in nanoseconds since the epoch as text; None stays None."""
    if time_ns is None:
        return None
    seconds, rest_ns = divmod(time_ns, 1_000_000_000)
    return f"{_second(seconds)}.{rest_ns // 1_000_000:03d}Z"


@lru_cache(maxsize=256)  # an answer has many times of the same second
def _second(seconds: int) -> str:
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}"


def with_texts(value: Any) -> Any:
    """Return JSON with the text beside each of its moments: `created` beside `created_ns`."""
    if isinstance(value, Mapping):
        texts = {
            key.removesuffix("_ns"): rfc3339(one)
            for key, one in value.items()
            if key.endswith("_ns") and (one is None or type(one) is int)
        }
        return {**texts, **{key: with_texts(one) for key, one in value.items()}}
    if isinstance(value, list | tuple):
        return [with_texts(one) for one in value]
    return value
