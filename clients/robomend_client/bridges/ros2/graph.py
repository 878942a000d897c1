"""The graph of a running robot with ROS 2, for a first model."""

from __future__ import annotations

import asyncio
import os
import time

from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros2.dds import Dds, configuration, only_here
from robomend_client.bridges.ros2.node import DdsNode
from robomend_client.python310 import end
from robomend_client.ros_graph import RosGraph

LEAST_S, QUIET_S, MOST_S = 3.0, 1.5, 15.0


def read_graph(domain: int) -> RosGraph:
    """Return the graph of a domain, when nothing new has come for QUIET_S, or after MOST_S.

    A node that has told nothing yet, or not whose a topic is, is waited for: on a busy computer that takes
    longer than to be seen.

    Raises:
        NoDds: the domain cannot be entered.
    """
    dds = Dds(domain, configuration(os.environ, only_here(os.environ), ()))
    try:
        return asyncio.run(_settled(dds))
    finally:
        dds.close()


async def _settled(dds: Dds) -> RosGraph:
    node = DdsNode("/robomend_from_ros", Problems("ROS 2"))
    task = asyncio.create_task(node.run(dds))
    began = changed = time.monotonic()
    before = RosGraph()
    try:
        while (now := time.monotonic()) < began + MOST_S:
            await asyncio.sleep(0.1)
            graph = node.found.graph()
            if graph != before:
                before, changed = graph, now
            elif node.found.untold or node.found.unnamed:
                continue
            elif now > began + LEAST_S and now > changed + QUIET_S:
                break
        return before
    finally:
        await end([task])
