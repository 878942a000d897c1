"""How tests wait: for what they need, with a bound. test_waiting.py refuses sleeps without a reason."""

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


def look_s(waited_s: float) -> float:
    """Return how long to wait for the next look: a tenth of what was waited, within bounds."""
    return min(max(LOOK_S, waited_s / 10), SELDOM_S)


def until(true: Callable[[], object], what: str, timeout_s: float = 30.0, *, closely: bool = False) -> None:
    """Wait until something holds; `closely`: it will not for long."""
    began = time.monotonic()
    while not true():
        waited_s = time.monotonic() - began
        assert waited_s < timeout_s, f"waited {timeout_s:g} s in vain: {what}"
        time.sleep(LOOK_S / 2 if closely else look_s(waited_s))  # until the next look


async def eventually(true: Callable[[], object], what: str, timeout_s: float = 30.0) -> None:
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
