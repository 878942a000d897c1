"""Waiting for what is to come, instead of sleeping for as long as it may take."""

from __future__ import annotations

import time
from collections.abc import Callable


def until(true: Callable[[], bool], what: str, timeout_s: float = 30.0) -> None:
    """Wait until something holds; `what` is said where it does not in time."""
    deadline = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)
