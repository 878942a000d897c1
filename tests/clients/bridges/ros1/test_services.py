"""Services of a real robot that are watched: every rospy node offers some."""

from __future__ import annotations

import asyncio
import signal
import socket
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

from tests.clients.bridges.ros1.listening import hearing
from tests.ros1 import Robot

LASER, NOBODY = "services:laser/get_loggers", "services:nobody/knows"


def test_a_service_answers_until_its_node_is_frozen_or_killed(ros: Robot, tmp_path: Path) -> None:
    laser = ros.node("laser")

    async def test() -> None:
        more = "ping_timeout_s: 0.3"
        async with hearing(tmp_path, ros.master.uri, LASER, NOBODY, more=more) as heard:
            await heard.until(lambda: heard.last(LASER) is True, "it answers")
            await heard.until(lambda: heard.last(NOBODY) is False, "that one is not there")
            laser.signal(signal.SIGSTOP)
            await heard.until(lambda: heard.last(LASER) is False, "it is frozen")
            await heard.more(LASER, 2)
            place = "the service /laser/get_loggers"
            assert len(heard.lines(f"{place}: it does not say who it is: nothing within 0.3 s")) == 1
            laser.signal(signal.SIGCONT)
            await heard.until(lambda: heard.last(LASER) is True, "it answers again")
            await heard.told(f"{place}: well again")
            laser.kill()
            await heard.until(lambda: heard.last(LASER) is False, "it is gone")

    asyncio.run(test())


def test_of_a_service_out_of_reach_nothing_is_said_and_one_that_speaks_garbage_is_none(
    ros: Robot, tmp_path: Path
) -> None:
    far, odd = "services:far/away", "services:odd/one"

    def register(name: str, uri: str) -> None:
        api: Any = ServerProxy(ros.master.uri)
        code, why, _ = api.registerService("/somebody", name, uri, "http://127.0.0.1:1/")
        assert code == 1, why

    async def garbage(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        writer.close()

    async def test() -> None:
        server = await asyncio.start_server(garbage, "127.0.0.1", 0, family=socket.AF_INET)
        port = server.sockets[0].getsockname()[1]
        await asyncio.to_thread(register, "/far/away", "rosrpc://no-such-robot.invalid:4711")
        await asyncio.to_thread(register, "/odd/one", f"rosrpc://127.0.0.1:{port}")
        async with hearing(tmp_path, ros.master.uri, far, odd) as heard:
            await heard.told("the service /far/away: the host name 'no-such-robot.invalid' is unknown here")
            await heard.more(odd)
            assert heard.last(odd) is False
            assert heard.count(far) == 0
            (line,) = heard.lines("the service /odd/one")
            assert "it does not say who it is: a header that is too long: 1347703880 bytes" in line
        server.close()

    asyncio.run(test())
