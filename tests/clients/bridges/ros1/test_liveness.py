"""Nodes of a real robot: killed, frozen, ended, started again."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

from tests.clients.bridges.hearing import Heard
from tests.clients.bridges.ros1.listening import hearing
from tests.ros1 import Robot
from tests.waiting import eventually


async def becomes(heard: Heard, node: str, runs: bool | None) -> None:
    def is_so() -> bool:
        table = heard.last("nodes")
        return table is not None and table.get(node, False) is runs

    await eventually(is_so, f"{node}: {runs}, not {heard.last('nodes')}", 60)


def test_a_killed_node_stops_and_a_frozen_one_too_until_it_goes_on(ros: Robot, tmp_path: Path) -> None:
    killed, frozen = ros.node("killed"), ros.node("frozen")

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes") as heard:
            await becomes(heard, "killed", True)
            await becomes(heard, "frozen", True)
            killed.kill()
            await becomes(heard, "killed", False)
            assert heard.last("nodes")["frozen"] is True
            frozen.signal(signal.SIGSTOP)
            await becomes(heard, "frozen", False)
            frozen.signal(signal.SIGCONT)
            await becomes(heard, "frozen", True)
            await asyncio.to_thread(ros.node, "killed")
            await becomes(heard, "killed", True)
            assert heard.lines("the node /frozen is frozen")

    asyncio.run(test())


def test_a_killed_node_is_found_by_its_connection_before_it_would_be_asked(
    ros: Robot, tmp_path: Path
) -> None:
    killed = ros.node("killed")

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes", more="ping_s: 60") as heard:
            await becomes(heard, "killed", True)
            killed.kill()
            await eventually(lambda: heard.last("nodes")["killed"] is False, "that it is gone", 40)

    asyncio.run(test())


def test_a_node_that_ends_in_order_stops_and_one_that_stops_publishing_does_not(
    ros: Robot, tmp_path: Path
) -> None:
    ends, stays = ros.node("ends"), ros.node("stays")
    stays.do("publish", topic="/scan", type="std_msgs/String", rate=20)

    async def test() -> None:
        # /rosout is the bridge's own business, and an observer's
        async with hearing(tmp_path, ros.master.uri, "nodes", "scan", "rosout") as heard:
            await becomes(heard, "ends", True)
            await becomes(heard, "stays", True)
            await heard.more("scan")
            await asyncio.to_thread(stays.do, "warn")
            await eventually(lambda: heard.count("rosout"), "a message of /rosout", 60)
            await asyncio.to_thread(stays.do, "unpublish", topic="/scan")
            await asyncio.to_thread(ends.do, "leave")
            await becomes(heard, "ends", False)
            await heard.more("nodes", 5)
            assert all(table.get("stays") for table in heard.values["nodes"] if "stays" in table)

    asyncio.run(test())


def test_nodes_go_on_while_the_master_is_gone_and_after_it_has_forgotten_them(
    ros: Robot, tmp_path: Path
) -> None:
    node = ros.node("steady")

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes") as heard:
            await becomes(heard, "steady", True)
            ros.master.stop()
            await heard.told("the master: nobody listens")
            await asyncio.to_thread(ros.master.start)
            await eventually(lambda: len(heard.lines("is known to the master")) == 2, "a second time", 60)
            await heard.more("nodes", 5)
            assert all(table.get("steady") for table in heard.values["nodes"])
            node.kill()
            await becomes(heard, "steady", False)

    asyncio.run(test())


def test_a_node_whose_host_is_unknown_is_unknown_not_stopped(ros: Robot, tmp_path: Path) -> None:
    ros.node("elsewhere", ROS_HOSTNAME="no-such-robot.invalid", ROS_IP="")

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes") as heard:
            await heard.told(
                "the host name 'no-such-robot.invalid' is unknown here; whether it runs is unknown"
            )
            assert heard.last("nodes")["elsewhere"] is None

    asyncio.run(test())


def test_nodes_with_names_that_ros_does_not_allow_are_told_once_and_watched(
    ros: Robot, tmp_path: Path
) -> None:
    ros.node("good")
    api: Any = ServerProxy(ros.master.uri)
    odd = ["/a b", "/käse", "/2nd", "/x; reboot", "/{{}}"]
    for name in (*odd, "/" + "y" * 500):  # the last one is long, and a name
        code, why, _ = api.registerSubscriber(name, "/nothing", "std_msgs/String", "http://127.0.0.1:9/")
        assert code == 1, why

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes") as heard:
            await becomes(heard, "good", True)
            await becomes(heard, "y" * 500, False)  # nobody listens there
            await heard.told("the node '/a b': ROS allows no such name")
            await heard.more("nodes", 3)
            assert len(heard.lines("ROS allows no such name")) == len(odd)
            assert {name[1:] for name in odd} <= {name for table in heard.values["nodes"] for name in table}
            assert heard.last("nodes")["good"] is True

    asyncio.run(test())
