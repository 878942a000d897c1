"""Nodes of a real robot: killed, frozen, ended, started again."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

import pytest
from tests.clients.bridges.ros1.listening import hearing
from tests.ros1 import Robot
from tests.waiting import eventually

from robomend_client.bridges.ros1 import master


def test_a_killed_node_stops_and_a_frozen_one_too_until_it_goes_on(ros: Robot, tmp_path: Path) -> None:
    killed, frozen = ros.node("killed"), ros.node("frozen")

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes") as heard:
            await heard.runs({"killed": True})
            await heard.runs({"frozen": True})
            killed.kill()
            await heard.runs({"killed": False})
            assert heard.last("nodes")["frozen"] is True
            assert heard.why["killed"]["symptom"] == "ended"
            frozen.signal(signal.SIGSTOP)
            await heard.runs({"frozen": False})
            assert heard.why["frozen"] == {"why": "does not answer within 1 s", "symptom": "halted"}
            frozen.signal(signal.SIGCONT)
            await heard.runs({"frozen": True})
            await asyncio.to_thread(ros.node, "killed")
            await heard.runs({"killed": True})
            assert heard.lines("the node /frozen is frozen")

    asyncio.run(test())


def test_a_killed_node_is_found_by_its_connection_before_it_would_be_asked(
    ros: Robot, tmp_path: Path
) -> None:
    killed = ros.node("killed")

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes", more="ping_s: 60") as heard:
            await heard.runs({"killed": True})
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
            await heard.runs({"ends": True})
            await heard.runs({"stays": True})
            await heard.more("scan")
            await asyncio.to_thread(stays.do, "warn")
            await eventually(lambda: heard.count("rosout"), "a message of /rosout", 60)
            await asyncio.to_thread(stays.do, "unpublish", topic="/scan")
            await asyncio.to_thread(ends.do, "leave")
            await heard.runs({"ends": False})
            await heard.more("nodes", 5)
            assert all(table.get("stays") for table in heard.values["nodes"] if "stays" in table)

    asyncio.run(test())


def test_nodes_go_on_while_the_master_is_gone_and_after_it_has_forgotten_them(
    ros: Robot, tmp_path: Path
) -> None:
    node = ros.node("steady")

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes") as heard:
            await heard.runs({"steady": True})
            ros.master.stop()
            await heard.told("the master: nobody listens")
            await asyncio.to_thread(ros.master.start)
            await eventually(lambda: len(heard.lines("is known to the master")) == 2, "a second time", 60)
            await heard.more("nodes", 5)
            assert all(table.get("steady") for table in heard.values["nodes"])
            node.kill()
            await heard.runs({"steady": False})

    asyncio.run(test())


def test_a_master_that_is_frozen_is_told_once_and_hides_no_node_that_ends(
    ros: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(master, "CALL_S", 2.0)
    killed = ros.node("killed")
    ros.node("steady").do("publish", topic="/scan", type="std_msgs/String", rate=20)

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "nodes", "scan") as heard:
            await heard.runs({"killed": True, "steady": True})
            await heard.more("scan")
            ros.master.signal(signal.SIGSTOP)
            await heard.told("the master: lookupNode was not answered within 2 s")
            killed.kill()
            await heard.runs({"killed": False, "steady": True})
            await heard.more("scan")
            assert len(heard.lines("the master: ")) == 1
            ros.master.signal(signal.SIGCONT)
            await heard.told("the master: well again")
            await asyncio.to_thread(ros.node, "killed")
            await heard.runs({"killed": True})
            assert all(table["steady"] for table in heard.values["nodes"] if "steady" in table)

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
            await heard.runs({"good": True})
            await heard.runs({"y" * 500: False})  # nobody listens there
            await heard.told("the node '/a b': ROS allows no such name")
            await heard.more("nodes", 3)
            assert len(heard.lines("ROS allows no such name")) == len(odd)
            assert {name[1:] for name in odd} <= {name for table in heard.values["nodes"] for name in table}
            assert heard.last("nodes")["good"] is True

    asyncio.run(test())
