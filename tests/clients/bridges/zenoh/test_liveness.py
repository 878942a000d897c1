"""Nodes that begin, end, are killed and frozen; and a network that goes away, or splits."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.clients.bridges.hearing import hearing, listening
from tests.node_process import NodeProcess
from tests.other_computer import OtherComputer, other_computer
from tests.zenoh_robot import NODE, ROUTER, ZenohRobot


def test_nodes_that_begin_end_freeze_and_are_killed(zenoh_robot: ZenohRobot) -> None:
    laser = zenoh_robot.node("laser")
    laser.do("also", name="camera", namespace="/front")
    laser.do("also", name="x" * 200)

    async def test() -> None:
        async with listening(zenoh_robot, "nodes") as heard:
            for node in ("laser", "front/camera", "x" * 200):
                await heard.runs({node: True})
            await asyncio.to_thread(laser.do, "no_longer", name="camera")
            await heard.runs({"front/camera": False})
            assert heard.last("nodes")["laser"] is True
            laser.signal(signal.SIGSTOP)
            await heard.runs({"laser": False})
            laser.signal(signal.SIGCONT)
            await heard.runs({"laser": True})
            laser.kill()
            await heard.runs({"laser": False})
            await asyncio.to_thread(zenoh_robot.node, "laser")
            await heard.runs({"laser": True})
            assert heard.log == []

    asyncio.run(test())


def test_without_a_router_nodes_run_on_and_without_anybody_nothing_is_said_of_them(
    zenoh_robot: ZenohRobot,
) -> None:
    zenoh_robot.stop_router()

    async def test() -> None:
        async with listening(zenoh_robot, "nodes") as heard:
            await heard.told("nobody answers at unixsock-stream/")
            assert heard.count("nodes") == 0
            assert len(heard.log) == 1
            await asyncio.to_thread(zenoh_robot.start_router)
            await asyncio.to_thread(zenoh_robot.node, "laser")
            await heard.runs({"laser": True})
            await asyncio.to_thread(zenoh_robot.stop_router)
            await heard.more("nodes", 3)  # nodes talk to each other without it
            assert heard.last("nodes")["laser"] is True
            zenoh_robot.nodes["laser"].kill()
            await heard.until(lambda: len(heard.lines("nobody answers at unixsock-stream/")) == 2, "again")
            tables = heard.count("nodes")
            assert heard.last("nodes")["laser"] is True  # the last that was known; its lifetime ends it
            await asyncio.to_thread(zenoh_robot.start_router)
            await asyncio.to_thread(zenoh_robot.node, "laser")
            await heard.until(lambda: heard.count("nodes") > tables, "a table")
            await heard.runs({"laser": True})

    asyncio.run(test())


@contextmanager
def running(folder: Path, commands: Mapping[str, Sequence[str]]) -> Iterator[dict[str, NodeProcess]]:
    """Routers and nodes, one after the other; they end in the other order."""
    nodes: dict[str, NodeProcess] = {}
    try:
        for name, command in commands.items():
            nodes[name] = NodeProcess(name, command, os.environ, folder)
            nodes[name].do("nothing")
        yield nodes
    finally:
        for process in reversed(nodes.values()):
            process.close()


def test_a_router_that_is_frozen_or_killed_hides_no_node_that_ends(tmp_path: Path) -> None:
    async def test(where: str, nodes: Mapping[str, NodeProcess]) -> None:
        keys = f"connect: ['{where}']\nname: robomend_test\ndiscovery_s: 0.5\n"
        async with hearing(tmp_path, "zenoh", keys, "nodes", "scan") as heard:
            await heard.runs({"laser": True, "mapper": True, "camera": True})
            await heard.more("scan")
            nodes["router"].signal(signal.SIGSTOP)
            nodes["laser"].kill()
            await heard.runs({"laser": False, "mapper": True, "camera": True})
            await heard.more("scan")
            nodes["router"].kill()
            nodes["mapper"].kill()
            await heard.runs({"mapper": False, "camera": True})
            await heard.more("scan")
            assert not any(table.get("camera", True) is False for table in heard.values["nodes"])

    with tempfile.TemporaryDirectory(prefix="zenoh-") as sockets:
        where = f"unixsock-stream/{sockets}/router"
        router = [sys.executable, "-c", ROUTER, where, ""]
        commands = {name: [sys.executable, str(NODE), where] for name in ("laser", "mapper", "camera")}
        with running(tmp_path, {"router": router, **commands}) as nodes:
            nodes["camera"].do("publish", topic="/scan", type="std_msgs/String", rate=10)
            asyncio.run(test(where, nodes))


def test_of_the_nodes_behind_a_split_network_it_is_unknown_whether_they_run_until_it_is_whole_again(
    tmp_path: Path,
) -> None:
    async def test(computer: OtherComputer, where: str, mapper: NodeProcess) -> None:
        keys = f"connect: ['{where}']\nname: robomend_test\ndiscovery_s: 0.5\n"
        async with hearing(tmp_path, "zenoh", keys, "nodes", "scan") as heard:
            await heard.runs({"laser": True, "mapper": True})
            await heard.more("scan")
            computer.cut()
            await heard.runs({"laser": None, "mapper": None})
            mapper.kill()
            computer.mend()
            await heard.runs({"laser": True, "mapper": False})  # its router is there again, and it is not
            await heard.more("scan")
            assert len(heard.lines("it does not answer any more")) == 1
            assert len(heard.lines("well again")) == 1
            tables = heard.values["nodes"]
            assert not any(table.get("laser") is False for table in tables)

    with other_computer() as computer, tempfile.TemporaryDirectory(prefix="zenoh-") as sockets:
        there, here = f"tcp/{computer.there}:7447", f"unixsock-stream/{sockets}/router"
        inside = [*computer.inside, sys.executable]
        commands = {
            "far": [*inside, "-c", ROUTER, there, ""],
            "near": [sys.executable, "-c", ROUTER, here, there],
            "laser": [*inside, str(NODE), there],
            "mapper": [*inside, str(NODE), there],
        }
        with running(tmp_path, commands) as nodes:
            nodes["laser"].do("publish", topic="/scan", type="std_msgs/String", rate=10)
            asyncio.run(test(computer, here, nodes["mapper"]))
