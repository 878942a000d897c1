"""A robot with Humble and rmw_cyclonedds, as far as it can be played without either."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path

from tests.clients.bridges.hearing import hearing
from tests.node_process import NodeProcess
from tests.ros2 import domain

from robomend_client.bridges.ros2.dds import Dds, configuration

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


def test_nodes_of_cyclone_dds_without_hashes_are_heard_and_garbage_beside_them_is_told_once(
    tmp_path: Path,
) -> None:
    async def test(number: int, laser: NodeProcess, odd: NodeProcess) -> None:
        keys = f"domain: {number}\ndiscovery: localhost\ndiscovery_s: 1\nname: robomend_test\n"
        async with hearing(tmp_path, "ros2", keys, "scan", "scan:data", "odd", "nodes") as heard:
            await heard.more("scan")
            await heard.until(lambda: heard.last("scan:data") == "far", "a field, by the types known here")
            await heard.runs({"laser": True, odd.name: True})
            await heard.told(f"the node '/{odd.name}': ROS allows no such name")
            laser.kill()
            await heard.runs({"laser": False, odd.name: True})
            await asyncio.to_thread(odd.do, "garbage")
            await heard.told("ros_discovery_info: a message cannot be read")
            await heard.more("odd")
            await heard.more("nodes")
            assert len(heard.log) == 2, heard.log

    with domain() as number:
        command = [sys.executable, str(NODE), str(number)]
        here = {**os.environ, "CYCLONEDDS_URI": HERE}
        nodes = [NodeProcess(name, command, here, tmp_path) for name in ("laser", "a b; reboot")]
        try:
            for node, topic in zip(nodes, ("/scan", "/odd"), strict=True):
                node.do("publish", topic=topic, data="far", rate=10)
            asyncio.run(test(number, *nodes))
        finally:
            for node in nodes:
                node.close()


def test_peers_are_asked_for_ever() -> None:
    """Who begins later than we do, and knows no way to us, is found by that alone: here nobody, at a port
    where a participant would be.
    """
    with domain() as number, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
        late.bind(("127.0.0.1", 7400 + 250 * number + 10 + 2 * 20))
        late.setblocking(False)
        ours = Dds(number, configuration({}, True, ()))
        try:
            time.sleep(32)  # Cyclone DDS asks for 30 s by itself: time is what is tested
            with suppress(BlockingIOError):
                while late.recv(65536):
                    pass
            late.settimeout(30)
            assert late.recv(65536).startswith(b"RTPS")
        finally:
            ours.close()


def test_a_computer_with_many_nodes_has_a_place_for_us() -> None:
    """Each has its two ports."""
    with domain() as number, ExitStack() as taken:
        for port in range(7400 + 250 * number + 10, 7400 + 250 * number + 10 + 2 * 80):
            one = taken.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            one.bind(("0.0.0.0", port))
        for peers in ((), ("127.0.0.1",)):
            Dds(number, configuration({}, True, peers)).close()
