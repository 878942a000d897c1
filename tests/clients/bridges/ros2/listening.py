"""A ROS 2 bridge in the test's own event loop."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager

from tests.clients.bridges.hearing import Heard
from tests.clients.bridges.hearing import hearing as any_hearing
from tests.ros2 import Ros2Robot


def hearing(
    ros: Ros2Robot, *sources: str, more: str = "", discovery: str = "localhost"
) -> AbstractAsyncContextManager[Heard]:
    """Run a bridge that observers want these sources of."""
    keys = f"domain: {ros.domain}\ndiscovery: {discovery}\nname: robomend_test\n{more}\n"
    return any_hearing(ros.folder, "ros2", keys, *sources)
