"""How tests wait: for what they need, with a bound; never for a time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import NoReturn

LOOK_S = 0.01
"""Between two looks, at first."""

SELDOM_S = 0.05
"""Between two looks, when it has taken half a second: a look is often a request, and keeps a processor busy
that others need to get there."""


SHARE = 3
"""So many times as long as a look took nobody looks: some read all of /proc and ask a service."""

MOST_S = 0.25
"""Between two looks, however long they take."""


def look_s(waited_s: float, took_s: float = 0.0) -> float:
    """Return how long to wait for the next look: a tenth of what was waited, within bounds, but no less
    than `SHARE` times what the look before `took_s`.
    """
    return max(min(max(LOOK_S, waited_s / 10), SELDOM_S), min(SHARE * took_s, MOST_S))


def until(true: Callable[[], object], what: str, timeout_s: float = 60.0, *, closely: bool = False) -> None:
    """Wait until something holds; `closely`: it will not for long."""
    began = looked = time.monotonic()
    while not true():
        now = time.monotonic()
        waited_s, took_s = now - began, now - looked
        assert waited_s < timeout_s, f"waited {timeout_s:g} s in vain: {what}"
        time.sleep(LOOK_S / 2 if closely else look_s(waited_s, took_s))  # until the next look
        looked = time.monotonic()


async def eventually(true: Callable[[], object], what: str, timeout_s: float = 60.0) -> None:
    """Wait until something holds, in the event loop."""
    began = time.monotonic()
    while not true():
        waited_s = time.monotonic() - began
        assert waited_s < timeout_s, f"waited {timeout_s:g} s in vain: {what}"
        await asyncio.sleep(look_s(waited_s))  # until the next look


async def for_ever() -> NoReturn:
    """Wait until whoever waits is cancelled: what hangs."""
    await asyncio.Event().wait()
    raise AssertionError("nobody sets it")
