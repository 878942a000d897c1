"""Times for people and for programs without 64-bit integers: RFC 3339, in UTC, to the millisecond."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import overload


@overload
def rfc3339(time_ns: int) -> str: ...
@overload
def rfc3339(time_ns: None) -> None: ...
def rfc3339(time_ns: int | None) -> str | None:
    """Return a time in nanoseconds since the epoch as text; None stays None."""
    if time_ns is None:
        return None
    seconds, rest_ns = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest_ns // 1_000_000:03d}Z"
