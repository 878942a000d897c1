"""Topics of a real robot, and what is wrong with those of bad ones."""

from __future__ import annotations

import asyncio
import math
import random
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from tests.clients.bridges.hearing import listening
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
        array: dict[str, Any] = {
            "type": "diagnostic_msgs/DiagnosticArray",
            "value": {"status": [STATUS]},
            "rate": 20,
        }
        for topic in ("diagnostics", "r1/diagnostics", "r1/diagnostics_agg"):
            node.do("publish", topic=f"/{topic}", **array)

        async def test() -> None:
            fields = ("scan:ranges.1", "scan:header.frame_id", "map:data", "diagnostics")
            async with listening(ros, "scan", *fields) as heard:
                for source in ("scan", "scan:header.frame_id", "diagnostics"):
                    await heard.more(source)
                await heard.until(lambda: heard.count("map:data"), "what was said before we came")
                assert heard.last("scan") is None  # nobody looks into it
                assert heard.last("scan:ranges.1") == 2.5
                assert heard.last("scan:header.frame_id") == "laser"
                assert heard.values["map:data"] == ["once"]
                levels = DiagnosticObserver("hokuyo", ["hokuyo: *"], ["temperature < 39"])
                levels.feed("diagnostics", 1, heard.last("diagnostics"))
                assert levels.check(1) == (fails("ok", "hokuyo"), fails("ok", "temperature"))
                assert heard.log == []
                garbage_to_our_ports()
                await heard.more("scan", 20)
                late = {"topic": "/scan", "type": "sensor_msgs/LaserScan", "rate": 20, "value": scan}
                await asyncio.to_thread(node.do, "unpublish", topic="/scan")
                await asyncio.to_thread(node.do, "publish", **late)
                await heard.more("scan", 20)
                assert heard.log == []
            aggregated = DiagnosticObserver("hokuyo", ["hokuyo: *"], source="diagnostics_agg")
            sources = sorted(aggregated.sources)
            async with listening(ros, "diagnostics", *sources, more="namespace: /r1") as heard:
                for source in ("diagnostics", *sources):
                    await heard.more(source)
                    aggregated.feed(source, 1, heard.last(source))
                assert aggregated.check(1) == (fails("ok", "hokuyo"),)

        asyncio.run(test())


def garbage_to_our_ports() -> None:
    """Whoever is on the network can send that; Cyclone DDS drops what is no RTPS, and half of one."""
    rng = random.Random(1)
    inodes = set()
    for link in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # it was that of the listing itself
            inodes.add(link.readlink().name.removeprefix("socket:[").removesuffix("]"))
    rows = [line.split() for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]]
    ports = [int(row[1].partition(":")[2], 16) for row in rows if row[9] in inodes]
    assert ports
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        for port in ports:
            for number in range(100):
                begin = (b"", b"RTPS", b"RTPS\x02\x01\x01\x10" + bytes(12) + b"\x15\x07")[number % 3]
                peer.sendto(begin + rng.randbytes(rng.randrange(1, 400)), ("127.0.0.1", port))


def test_what_is_wrong_with_topics_is_told_once_and_the_rest_is_heard(ros2: Ros2Robot) -> None:
    bad, mapper = ros2.node("bad"), ros2.node("mapper")
    string = {"type": "std_msgs/String", "rate": 20}
    number = {"type": "std_msgs/Float64", "rate": 20}
    bad.do("publish", topic="/x", raw="0001000009000000ffff", **string)
    bad.do("publish", topic="/nan", value={"data": math.nan}, **number)
    bad.do("publish", topic="/odd", value={"data": 1.0}, **number)
    bad.do("publish", topic="/changes", value={"data": 1.5}, **number)
    bad.do("publish", topic="/scan", reliable=False, **string)
    mapper.do("subscribe", topic="/scan", type="std_msgs/String")

    async def test() -> None:
        sources = ("x", "x:data", "nan:data", "odd:nothing", "odd", "scan", "changes", "changes:data")
        async with listening(ros2, *sources) as heard:
            for source in ("x", "nan:data", "odd", "scan", "changes:data"):  # we hear it whatever it offers
                await heard.more(source)
            for told in (
                "messages of /x by /bad: a message of std_msgs/String cannot be read",
                "/odd by /bad, nothing: no field nothing",
                "/scan, its nodes: /bad publishes best effort, /mapper asks for reliable",
            ):
                await heard.told(told)
            await heard.more("x", 5)
            assert heard.count("x:data") == 0
            assert math.isnan(heard.last("nan:data"))
            text = {"topic": "/changes", "value": {"data": "now"}, **string}
            await asyncio.to_thread(mapper.do, "publish", **text)
            await heard.until(lambda: heard.last("changes:data") == "now", "the new type's messages")
            await heard.told("publishes std_msgs/String, where std_msgs/Float64 came before")
            await heard.more("changes")
            await asyncio.to_thread(bad.do, "unpublish", topic="/scan")
            await heard.told("/scan, its nodes: well again")
            await asyncio.to_thread(bad.do, "publish", topic="/scan", **string)
            await heard.more("scan")
            for once in ("messages of /x", "no field nothing", "asks for reliable", "came before"):
                assert len(heard.lines(once)) == 1, once

    asyncio.run(test())
