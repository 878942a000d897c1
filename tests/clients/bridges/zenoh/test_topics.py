"""Topics of nodes that speak as rmw_zenoh does, and what is wrong with those of bad ones."""

from __future__ import annotations

import asyncio
import math

import pytest
from tests.clients.bridges.zenoh.listening import hearing
from tests.zenoh_robot import ZenohRobot

from robomend_client.literals import fails
from robomend_client.observers import DiagnosticObserver

STATUS = {"name": "hokuyo: connection", "level": 1, "values": [{"key": "temperature", "value": "39.5"}]}


def test_ticks_fields_and_diagnostics_come_over_zenoh(zenoh_robot: ZenohRobot) -> None:
    node = zenoh_robot.node("driver")
    scan = {"ranges": [1.0, 2.5], "header": {"frame_id": "laser"}}
    node.do("publish", topic="/robot1/scan", type="sensor_msgs/LaserScan", value=scan, rate=20)
    node.do("publish", topic="/map", type="std_msgs/String", value={"data": "once"}, latched=True)
    node.do("publish", topic="/map/more", type="std_msgs/String", value={"data": "not asked for"}, rate=20)
    array = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray"}
    node.do("publish", value={"status": [STATUS]}, rate=20, **array)

    async def test() -> None:
        scan = "robot1/scan"
        fields = (f"{scan}:ranges.1", f"{scan}:header.frame_id", "map:data", "diagnostics")
        async with hearing(zenoh_robot, scan, *fields) as heard:
            for source in (scan, f"{scan}:header.frame_id", "diagnostics"):
                await heard.more(source)
            await heard.until(lambda: heard.count("map:data"), "what was said before we came")
            assert heard.last(scan) is None  # nobody looks into it
            assert heard.last(f"{scan}:ranges.1") == 2.5
            assert heard.last(f"{scan}:header.frame_id") == "laser"
            assert set(heard.values["map:data"]) == {"once"}
            levels = DiagnosticObserver("hokuyo", ["hokuyo: *"], ["temperature < 39"])
            levels.feed("diagnostics", 1, heard.last("diagnostics"))
            assert levels.check(1) == (fails("ok", "hokuyo"), fails("ok", "temperature"))
            assert heard.log == []

    asyncio.run(test())


@pytest.mark.parametrize("form", ["bare", "no length", "named", "none", "ff"])
def test_messages_of_every_release_are_heard_whatever_is_attached(form: str, zenoh_robot: ZenohRobot) -> None:
    node = zenoh_robot.node("driver")
    more = {"hash": "TypeHashNotSupported"} if form == "none" else {}
    string = {"topic": "/x", "type": "std_msgs/String", "value": {"data": "y"}, "rate": 20}
    node.do("publish", attachment=form, **string, **more)

    async def test() -> None:
        async with hearing(zenoh_robot, "x", "x:data") as heard:
            await heard.more("x:data")
            assert heard.last("x:data") == "y"
            why = "not understood, timed by its arrival: 1 bytes"
            told = [f"what /driver attaches to messages of /x: {why}"] * (form == "ff")
            assert len(heard.log) == len(told)
            assert all(line in heard.log[0] for line in told)

    asyncio.run(test())


def test_a_topic_that_changes_its_type_is_told_and_heard_on(zenoh_robot: ZenohRobot) -> None:
    number = zenoh_robot.node("number")
    number.do("publish", topic="/x", type="std_msgs/Float64", value={"data": 1.5}, rate=20)

    async def test() -> None:
        async with hearing(zenoh_robot, "x", "x:data") as heard:
            await heard.more("x:data")
            assert heard.last("x:data") == 1.5
            other = await asyncio.to_thread(zenoh_robot.node, "text")
            await asyncio.to_thread(number.do, "unpublish", topic="/x")
            text = {"topic": "/x", "type": "std_msgs/String", "value": {"data": "now"}, "rate": 20}
            await asyncio.to_thread(other.do, "publish", **text)
            await heard.until(lambda: heard.last("x:data") == "now", "the new type's messages")
            await heard.told("/text publishes std_msgs/String, where std_msgs/Float64 came before")
            await heard.more("x")
            assert len(heard.lines("came before")) == 1

    asyncio.run(test())


def test_what_is_no_message_of_its_type_counts_and_is_told_once_and_nan_is_a_number(
    zenoh_robot: ZenohRobot,
) -> None:
    node = zenoh_robot.node("bad")
    node.do("publish", topic="/x", type="std_msgs/String", raw="0001000009000000ffff", rate=20)
    node.do("publish", topic="/empty", type="std_msgs/String", raw="", rate=20)
    node.do("publish", topic="/nan", type="std_msgs/Float64", value={"data": math.nan}, rate=20)
    node.do("publish", topic="/odd", type="std_msgs/Float64", value={"data": 1.0}, rate=20)
    node.do("publish", topic="/other", type="std_msgs/Float64", hash="RIHS01_" + "0" * 64, rate=20)

    async def test() -> None:
        sources = ("x", "x:data", "nan:data", "odd:nothing", "odd", "other:data", "empty:data")
        async with hearing(zenoh_robot, *sources) as heard:
            await heard.more("x", 5)
            await heard.more("nan:data")
            await heard.more("odd")
            await heard.told("/odd by /bad, nothing: no field nothing")
            await heard.told("messages of /x by /bad: a message of std_msgs/String cannot be read")
            await heard.told("messages of /empty by /bad: a message of std_msgs/String cannot be read")
            await heard.told("messages of /other by /bad: the definition of std_msgs/Float64 here is not its")
            await heard.more("x", 5)
            assert heard.count("x:data") == 0
            assert math.isnan(heard.last("nan:data"))
            assert len(heard.log) == 4

    asyncio.run(test())


def test_nodes_whose_types_do_not_meet_are_told_once_with_their_topic(zenoh_robot: ZenohRobot) -> None:
    laser = zenoh_robot.node("laser")
    laser.do("publish", topic="/scan", type="std_msgs/String", rate=20)
    zenoh_robot.node("mapper").do("subscribe", topic="/scan", type="std_msgs/Float64")
    odd = {"topic": "/odd", "type": "std_msgs/String"}
    laser.do("publish", rate=20, **odd)
    zenoh_robot.nodes["mapper"].do("subscribe", hash="RIHS01_" + "1" * 64, **odd)

    async def test() -> None:
        async with hearing(zenoh_robot, "scan") as heard:
            await heard.told(
                "/laser publishes std_msgs/String, /mapper asks for std_msgs/Float64: no message"
            )
            await heard.told(
                "/odd, its nodes: /laser publishes std_msgs/String of another definition, /mapper"
            )
            await heard.more("scan")  # we hear it of any type
            await asyncio.to_thread(laser.do, "unpublish", topic="/scan")
            await heard.told("/scan, its nodes: well again")
            assert len(heard.lines("asks for std_msgs/Float64")) == 1

    asyncio.run(test())


def test_what_is_no_token_is_told_and_disturbs_nothing(zenoh_robot: ZenohRobot) -> None:
    node = zenoh_robot.node("driver")
    for key in ("@ros2_lv/0/x", "@ros2_lv/0/a/0/0/XX/%/%/n", "@ros2_lv/0/a/0/1/MP/%/%/n/%x"):
        node.do("bare_token", key=key)
    node.do("publish", topic="/x", type="std_msgs/String", value={"data": "y"}, rate=20)

    async def test() -> None:
        async with hearing(zenoh_robot, "x:data", "nodes") as heard:
            await heard.more("x:data")
            await heard.until(lambda: heard.count("nodes"), "a table")
            assert heard.last("nodes")["driver"] is True
            await heard.told("a token: '@ros2_lv/0/x' is no token")
            assert len(heard.lines("a token")) == 3

    asyncio.run(test())


def test_a_node_whose_name_ros_does_not_allow_is_told_once_and_watched(zenoh_robot: ZenohRobot) -> None:
    node = zenoh_robot.node("driver")
    node.do("also", name="a b")

    async def test() -> None:
        async with hearing(zenoh_robot, "nodes") as heard:
            await heard.until(lambda: (heard.last("nodes") or {}).get("a b"), "it runs")
            await heard.told("the node '/a b': ROS allows no such name")
            await asyncio.to_thread(node.do, "no_longer", name="a b")
            await heard.until(lambda: not heard.last("nodes").get("a b"), "it does not run")
            assert len(heard.log) == 1

    asyncio.run(test())
