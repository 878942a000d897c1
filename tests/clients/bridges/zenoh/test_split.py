"""A network that splits between two computers, each with a router of its own."""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
from pathlib import Path

from tests.clients.bridges.hearing import hearing
from tests.node_process import NodeProcess
from tests.other_computer import OtherComputer, other_computer
from tests.zenoh_robot import NODE, ROUTER


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
        started: dict[str, NodeProcess] = {}
        try:
            for name, command in commands.items():
                started[name] = NodeProcess(name, command, os.environ, tmp_path)
                started[name].do("nothing")
            started["laser"].do("publish", topic="/scan", type="std_msgs/String", rate=10)
            asyncio.run(test(computer, here, started["mapper"]))
        finally:
            for process in reversed(started.values()):
                process.close()
