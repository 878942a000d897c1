"""Topics of a real robot, and what is wrong with those of bad ones."""

from __future__ import annotations

import asyncio
import math
import random
import socket
from contextlib import suppress
from pathlib import Path

import pytest
from tests.clients.bridges.ros2.listening import hearing
from tests.packages import JAZZY, KILTED, WantedRos2
from tests.ros2 import Ros2Robot, robot

from robomend_client.literals import fails
from robomend_client.observers import DiagnosticObserver

STATUS = {"name": "hokuyo: connection", "level": 1, "values": [{"key": "temperature", "value": "39.5"}]}


@pytest.mark.parametrize("release", [KILTED, JAZZY], ids=["kilted", "jazzy"])
def test_ticks_fields_and_diagnostics_come_from_a_real_robot(release: WantedRos2, tmp_path: Path) -> None:
    """Types in types are what current Fast DDS and Cyclone DDS do not agree on without our configuration."""
    with robot(tmp_path, release) as ros:
        node = ros.node("driver")
        scan = {"ranges": [1.0, 2.5], "header": {"frame_id": "laser"}}
        node.do("publish", topic="/scan", type="sensor_msgs/LaserScan", value=scan, rate=20, reliable=False)
        node.do("publish", topic="/map", type="std_msgs/String", value={"data": "once"}, latched=True)
        array = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray"}
        node.do("publish", value={"status": [STATUS]}, rate=20, **array)

        async def test() -> None:
            fields = ("scan:ranges.1", "scan:header.frame_id", "map:data", "diagnostics")
            async with hearing(ros, "scan", *fields) as heard:
                for source in ("scan", "scan:header.frame_id", "diagnostics"):
                    await heard.more(source)
                await heard.more("map:data", 1) if not heard.count("map:data") else None
                assert heard.last("scan") is None  # nobody looks into it
                assert heard.last("scan:ranges.1") == 2.5
                assert heard.last("scan:header.frame_id") == "laser"
                assert heard.values["map:data"] == ["once"]  # it was said before we came
                levels = DiagnosticObserver("hokuyo", ["hokuyo: *"], ["temperature < 39"])
                levels.feed("diagnostics", 1, heard.last("diagnostics"))
                assert levels.check(1) == (fails("ok", "hokuyo"), fails("ok", "temperature"))
                assert heard.log == []

        asyncio.run(test())


def test_a_topic_that_changes_its_type_is_told_and_heard_on(ros: Ros2Robot) -> None:
    ros.node("number").do("publish", topic="/x", type="std_msgs/Float64", value={"data": 1.5}, rate=20)

    async def test() -> None:
        async with hearing(ros, "x", "x:data") as heard:
            await heard.more("x:data")
            assert heard.last("x:data") == 1.5
            other = await asyncio.to_thread(ros.node, "text")
            text = {"topic": "/x", "type": "std_msgs/String", "value": {"data": "now"}, "rate": 20}
            await asyncio.to_thread(other.do, "publish", **text)
            await heard.until(lambda: heard.last("x:data") == "now", "the new type's messages")
            await heard.told("publishes std_msgs/String, where std_msgs/Float64 came before")
            await heard.more("x")
            assert len(heard.lines("came before")) == 1

    asyncio.run(test())


def test_what_is_no_message_of_its_type_counts_and_is_told_once_and_nan_is_a_number(ros: Ros2Robot) -> None:
    node = ros.node("bad")
    node.do("publish", topic="/x", type="std_msgs/String", raw="0001000009000000ffff", rate=20)
    node.do("publish", topic="/nan", type="std_msgs/Float64", value={"data": math.nan}, rate=20)
    node.do("publish", topic="/odd", type="std_msgs/Float64", value={"data": 1.0}, rate=20)

    async def test() -> None:
        async with hearing(ros, "x", "x:data", "nan:data", "odd:nothing", "odd") as heard:
            await heard.more("x", 5)
            await heard.more("nan:data")
            await heard.more("odd")
            await heard.told("cannot be read")
            await heard.told("no field nothing")
            await heard.more("x", 5)
            assert heard.count("x:data") == 0
            assert math.isnan(heard.last("nan:data"))
            (unread,) = heard.lines("cannot be read")
            assert "messages of /x by /bad: a message of std_msgs/String cannot be read" in unread
            (missing,) = heard.lines("no field nothing")
            assert "/odd by /bad, nothing" in missing

    asyncio.run(test())


def test_nodes_whose_qualities_of_service_do_not_meet_are_told_once_with_their_topic(ros: Ros2Robot) -> None:
    laser = ros.node("laser")
    laser.do("publish", topic="/scan", type="std_msgs/String", rate=20, reliable=False)
    ros.node("mapper").do("subscribe", topic="/scan", type="std_msgs/String")

    async def test() -> None:
        async with hearing(ros, "scan") as heard:
            await heard.told("/scan, its nodes: /laser publishes best effort, /mapper asks for reliable")
            await heard.more("scan")  # we hear it whatever it offers
            await asyncio.to_thread(laser.do, "unpublish", topic="/scan")
            await heard.told("/scan, its nodes: well again")
            again = {"topic": "/scan", "type": "std_msgs/String", "rate": 20}
            await asyncio.to_thread(laser.do, "publish", **again)
            await heard.more("scan")
            assert len(heard.lines("asks for reliable")) == 1

    asyncio.run(test())


def test_datagrams_of_garbage_to_our_ports_change_nothing(ros: Ros2Robot) -> None:
    """Whoever is on the network can send them; Cyclone DDS drops what is no RTPS, and half of one."""
    ros.node("laser").do("publish", topic="/scan", type="std_msgs/String", rate=20)

    async def test() -> None:
        async with hearing(ros, "scan") as heard:
            await heard.more("scan")
            rng = random.Random(1)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
                ports = own_ports()
                assert ports
                for port in ports:
                    for number in range(100):
                        begin = (b"", b"RTPS", b"RTPS\x02\x01\x01\x10" + bytes(12) + b"\x15\x07")[number % 3]
                        peer.sendto(begin + rng.randbytes(rng.randrange(1, 400)), ("127.0.0.1", port))
            await heard.more("scan", 20)
            late = await asyncio.to_thread(ros.node, "late")
            await asyncio.to_thread(late.do, "publish", topic="/scan", type="std_msgs/String", rate=20)
            await heard.more("scan", 20)
            assert heard.log == []

    asyncio.run(test())


def own_ports() -> list[int]:
    """Return the UDP ports on which this process listens."""
    inodes = set()
    for link in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # it was that of the listing itself
            inodes.add(link.readlink().name.removeprefix("socket:[").removesuffix("]"))
    rows = [line.split() for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]]
    return [int(row[1].partition(":")[2], 16) for row in rows if row[9] in inodes]
