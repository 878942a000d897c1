"""A ROS 1 bridge in the test's own event loop."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from pathlib import Path

from tests.clients.bridges.hearing import Heard
from tests.clients.bridges.hearing import hearing as any_hearing


def hearing(folder: Path, master: str, *sources: str, more: str = "") -> AbstractAsyncContextManager[Heard]:
    """Run a bridge that observers want these sources of."""
    keys = f"master: '{master}'\nname: robomend_test\n{more}\n"
    return any_hearing(folder, "ros1", keys, *sources)
