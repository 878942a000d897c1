"""How tests wait: for what they need, with a bound. test_waiting.py refuses sleeps without a reason."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import NoReturn

LOOK_S = 0.01
"""Between two looks."""


def until(true: Callable[[], object], what: str, timeout_s: float = 30.0) -> None:
    """Wait until something holds."""
    deadline = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < deadline, f"waited {timeout_s:g} s in vain: {what}"
        time.sleep(LOOK_S)


async def eventually(true: Callable[[], object], what: str, timeout_s: float = 30.0) -> None:
    """Wait until something holds, in the event loop."""
    deadline = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < deadline, f"waited {timeout_s:g} s in vain: {what}"
        await asyncio.sleep(LOOK_S)


async def for_ever() -> NoReturn:
    """Wait until whoever waits is cancelled: what hangs."""
    await asyncio.Event().wait()
    raise AssertionError("nobody sets it")
