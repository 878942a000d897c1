"""A robot with Humble and rmw_cyclonedds, as far as it can be played without either."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from tests.clients.bridges.hearing import hearing
from tests.node_process import NodeProcess
from tests.ros2 import domain

NODE = Path(__file__).parents[3] / "cyclone_node.py"
HERE = (
    '<CycloneDDS><Domain id="any">'
    '<General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
    "<Compatibility><IgnoreTypeInformation>1.16</IgnoreTypeInformation></Compatibility>"
    "</Domain></CycloneDDS>"
)
"""rmw_cyclonedds has no type information, which the wheel cannot do without; so it does not look at ours."""


def beside_a_node(
    name: str, test: Callable[[int, NodeProcess], Coroutine[Any, Any, None]], folder: Path
) -> None:
    """Run a test in a domain in which a node of this name publishes /scan."""
    with domain() as number:
        command = [sys.executable, str(NODE), str(number)]
        node = NodeProcess(name, command, {**os.environ, "CYCLONEDDS_URI": HERE}, folder)
        try:
            node.do("publish", topic="/scan", data="far", rate=10)
            asyncio.run(test(number, node))
        finally:
            node.close()


def test_a_node_of_cyclone_dds_without_hashes_is_heard_and_seen_to_end(tmp_path: Path) -> None:
    async def test(number: int, laser: NodeProcess) -> None:
        keys = f"domain: {number}\ndiscovery: localhost\ndiscovery_s: 1\nname: robomend_test\n"
        async with hearing(tmp_path, "ros2", keys, "scan", "scan:data", "nodes") as heard:
            await heard.more("scan")
            await heard.until(lambda: heard.last("scan:data") == "far", "a field, by the types known here")
            await heard.until(lambda: (heard.last("nodes") or {}).get("laser"), "it runs")
            laser.kill()
            await heard.until(lambda: not heard.last("nodes").get("laser", False), "it does not run")
            assert heard.log == []

    beside_a_node("laser", test, tmp_path)


def test_a_name_that_ros_does_not_allow_and_a_graph_that_is_none_are_told_and_the_rest_is_heard(
    tmp_path: Path,
) -> None:
    async def test(number: int, odd: NodeProcess) -> None:
        keys = f"domain: {number}\ndiscovery: localhost\ndiscovery_s: 1\nname: robomend_test\n"
        async with hearing(tmp_path, "ros2", keys, "scan", "nodes") as heard:
            await heard.more("scan")
            await asyncio.to_thread(odd.do, "garbage")
            await heard.told("ros_discovery_info: a message cannot be read")
            await heard.until(lambda: (heard.last("nodes") or {}).get("a b; reboot"), "it runs")
            await heard.told("the node '/a b; reboot': ROS allows no such name")
            await heard.more("scan")
            await heard.more("nodes")
            assert len(heard.lines("ROS allows no such name")) == 1
            assert len(heard.lines("ros_discovery_info")) == 1

    beside_a_node("a b; reboot", test, tmp_path)
