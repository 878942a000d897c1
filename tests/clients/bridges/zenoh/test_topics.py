"""Topics of nodes that speak as rmw_zenoh does, and what is wrong with those of bad ones."""

from __future__ import annotations

import asyncio
import math

from tests.clients.bridges.hearing import listening
from tests.zenoh_robot import ZenohRobot

from robomend_client.literals import fails
from robomend_client.observers import DiagnosticObserver

STATUS = {"name": "hokuyo: connection", "level": 1, "values": [{"key": "temperature", "value": "39.5"}]}


ATTACHED = ("bare", "no length", "named", "none", "ff")
"""What releases attach to their messages, and something that is no attachment."""


def test_ticks_fields_and_diagnostics_come_over_zenoh_whatever_is_attached(zenoh_robot: ZenohRobot) -> None:
    node = zenoh_robot.node("driver")
    scan = {"ranges": [1.0, 2.5], "header": {"frame_id": "laser"}}
    string = {"type": "std_msgs/String", "rate": 20}
    node.do("publish", topic="/robot1/scan", type="sensor_msgs/LaserScan", value=scan, rate=20)
    node.do("publish", topic="/map", type="std_msgs/String", value={"data": "once"}, latched=True)
    node.do("publish", topic="/map/more", value={"data": "not asked for"}, **string)
    array = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray"}
    node.do("publish", value={"status": [STATUS]}, rate=20, **array)
    for number, form in enumerate(ATTACHED):
        more = {"hash": "TypeHashNotSupported"} if form == "none" else {}
        node.do("publish", topic=f"/x{number}", attachment=form, value={"data": form}, **string, **more)
    for key in ("@ros2_lv/0/x", "@ros2_lv/0/a/0/0/XX/%/%/n", "@ros2_lv/0/a/0/1/MP/%/%/n/%x"):
        node.do("bare_token", key=key)
    node.do("also", name="a b")

    async def test() -> None:
        scan = "robot1/scan"
        fields = (f"{scan}:ranges.1", f"{scan}:header.frame_id", "map:data", "diagnostics")
        formed = [f"x{number}:data" for number in range(len(ATTACHED))]
        async with listening(zenoh_robot, scan, *fields, *formed, "nodes") as heard:
            for source in (scan, f"{scan}:header.frame_id", "diagnostics", *formed):
                await heard.more(source)
            await heard.until(lambda: heard.count("map:data"), "what was said before we came")
            assert heard.last(scan) is None  # nobody looks into it
            assert heard.last(f"{scan}:ranges.1") == 2.5
            assert heard.last(f"{scan}:header.frame_id") == "laser"
            assert set(heard.values["map:data"]) == {"once"}
            assert tuple(map(heard.last, formed)) == ATTACHED
            levels = DiagnosticObserver("hokuyo", ["hokuyo: *"], ["temperature < 39"])
            levels.feed("diagnostics", 1, heard.last("diagnostics"))
            assert levels.check(1) == (fails("ok", "hokuyo"), fails("ok", "temperature"))
            await heard.runs({"driver": True, "a b": True})
            for told in (
                "what /driver attaches to messages of /x4: not understood, timed by its arrival: 1 bytes",
                "a token: '@ros2_lv/0/x' is no token",
                "the node '/a b': ROS allows no such name",
            ):
                await heard.told(told)
            await asyncio.to_thread(node.do, "no_longer", name="a b")
            await heard.runs({"driver": True, "a b": False})
            assert len(heard.lines("a token")) == 3
            assert len(heard.log) == 5, heard.log

    asyncio.run(test())


def test_what_is_wrong_with_topics_is_told_once_and_the_rest_is_heard(zenoh_robot: ZenohRobot) -> None:
    bad, mapper = zenoh_robot.node("bad"), zenoh_robot.node("mapper")
    string = {"type": "std_msgs/String", "rate": 20}
    number = {"type": "std_msgs/Float64", "rate": 20}
    bad.do("publish", topic="/x", raw="0001000009000000ffff", **string)
    bad.do("publish", topic="/empty", raw="", **string)
    bad.do("publish", topic="/swapped", raw="00000000000000000000f83f", **number)  # 1.5, if it said so
    bad.do("publish", topic="/nan", value={"data": math.nan}, **number)
    bad.do("publish", topic="/odd", value={"data": 1.0}, **number)
    bad.do("publish", topic="/other", hash="RIHS01_" + "0" * 64, **number)
    bad.do("publish", topic="/changes", value={"data": 1.5}, **number)
    bad.do("publish", topic="/scan", **string)
    mapper.do("subscribe", topic="/scan", type="std_msgs/Float64")
    mapper.do("subscribe", topic="/map", type="std_msgs/String", hash="RIHS01_" + "1" * 64)
    bad.do("publish", topic="/map", **string)

    async def test() -> None:
        sources = ("x", "x:data", "nan:data", "odd:nothing", "odd", "other:data", "empty:data", "scan")
        async with listening(zenoh_robot, *sources, "swapped:data", "changes", "changes:data") as heard:
            for source in ("x", "nan:data", "odd", "scan", "changes:data"):  # we hear it of any type
                await heard.more(source)
            why = "a message of std_msgs/String cannot be read"
            for told in (
                "/odd by /bad, nothing: no field nothing",
                f"messages of /x by /bad: {why}",
                f"messages of /empty by /bad: {why}",
                "messages of /swapped by /bad: a message of std_msgs/Float64 cannot be read",
                "messages of /other by /bad: the definition of std_msgs/Float64 here is not its",
                "/bad publishes std_msgs/String, /mapper asks for std_msgs/Float64: no message",
                "/map, its nodes: /bad publishes std_msgs/String of another definition, /mapper",
            ):
                await heard.told(told)
            await heard.more("x", 5)
            assert heard.count("x:data") == heard.count("swapped:data") == 0
            assert math.isnan(heard.last("nan:data"))
            await asyncio.to_thread(bad.do, "unpublish", topic="/changes")
            await asyncio.to_thread(mapper.do, "publish", topic="/changes", value={"data": "now"}, **string)
            await heard.until(lambda: heard.last("changes:data") == "now", "the new type's messages")
            await heard.told("/mapper publishes std_msgs/String, where std_msgs/Float64 came before")
            await heard.more("changes")
            await asyncio.to_thread(bad.do, "unpublish", topic="/scan")
            await heard.told("/scan, its nodes: well again")
            assert len(heard.log) == 9, heard.log

    asyncio.run(test())
