"""Times and lifetimes as logs write them, to integer nanoseconds.

    1764000000000000000        an integer: nanoseconds since the epoch
    1764000000.25              a number with a fraction: seconds
    2026-11-24T16:00:00.25Z    ISO 8601; without a zone it is UTC

A lifetime is seconds, with a fraction or without.
"""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime

from robomend.observations.obs import FOREVER
from robomend_client.observers.base import SECOND

_INTEGER = re.compile(r"[+-]?[0-9]+\Z")
_NUMBER = re.compile(r"([+-]?)([0-9]+)\.([0-9]*)\Z")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

LATEST_NS = 1 << 62


def time_ns(value: object) -> int:
    """Return a time; ValueError if it is none."""
    if isinstance(value, str):
        found = _of_text(value.strip())
    elif isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"no time: {value!r}")
    elif isinstance(value, int):
        found = value
    elif math.isfinite(value):
        found = round(value * SECOND)
    else:
        raise ValueError(f"no time: {value!r}")
    if abs(found) > LATEST_NS:
        raise ValueError(f"no time: {value!r} is out of range")
    return found


def _of_text(text: str) -> int:
    if _INTEGER.match(text):
        return int(text)
    if found := _NUMBER.match(text):  # exactly: a float has no nanoseconds left
        sign, seconds, fraction = found.groups()
        size = int(seconds) * SECOND + int(fraction.ljust(9, "0")[:9])
        return -size if sign == "-" else size
    try:
        at = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"no time: {text!r}") from None
    since = (at if at.tzinfo else at.replace(tzinfo=UTC)) - _EPOCH
    return ((since.days * 86400 + since.seconds) * 1_000_000 + since.microseconds) * 1000


def expires_ns(at_ns: int, lifetime: object) -> int:
    """Return until when something counts; None or an empty lifetime is for ever.

    Raises:
        ValueError: it is no lifetime.
    """
    if lifetime is None or lifetime == "":
        return FOREVER
    try:
        seconds = float(lifetime)  # type: ignore[arg-type]  # what it cannot take, it says
    except (TypeError, ValueError):
        raise ValueError(f"no lifetime in seconds: {lifetime!r}") from None
    if isinstance(lifetime, bool) or not seconds >= 0:
        raise ValueError(f"no lifetime in seconds: {lifetime!r}")
    return FOREVER if seconds * SECOND > LATEST_NS else at_ns + round(seconds * SECOND)
