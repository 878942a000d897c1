"""A bridge over zenoh in the test's own event loop."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager

from tests.clients.bridges.hearing import Heard
from tests.clients.bridges.hearing import hearing as any_hearing
from tests.zenoh_robot import ZenohRobot


def hearing(ros: ZenohRobot, *sources: str, more: str = "") -> AbstractAsyncContextManager[Heard]:
    """Run a bridge that observers want these sources of."""
    keys = (
        f"domain: {ros.domain}\nconnect: ['{ros.endpoint}']\nname: robomend_test\ndiscovery_s: 0.5\n{more}\n"
    )
    return any_hearing(ros.folder, "zenoh", keys, *sources)
