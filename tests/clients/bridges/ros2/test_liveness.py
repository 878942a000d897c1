"""Nodes of a real robot that begin, end, are killed and frozen."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

from tests.clients.bridges.hearing import listening
from tests.clients.bridges.ros2.test_split import soon_lost
from tests.ros2 import Ros2Robot, robot

from robomend_client.bridges.ros2.discovered import Participant
from robomend_client.bridges.ros2.liveness import find


def test_nodes_that_begin_end_freeze_and_are_killed(ros2: Ros2Robot) -> None:
    laser = ros2.node("laser")
    laser.do("also", name="camera", namespace="/front")
    laser.do("also", name="x" * 200)

    async def test() -> None:
        async with listening(ros2, "nodes", more="discovery_s: 1") as heard:
            for node in ("laser", "front/camera", "x" * 200):
                await heard.runs({node: True})
            await asyncio.to_thread(laser.do, "no_longer", name="camera")
            await heard.runs({"front/camera": False})
            assert heard.last("nodes")["laser"] is True
            laser.signal(signal.SIGSTOP)
            await heard.runs({"laser": False})
            stopped = f"its process {laser.pid} is stopped by a signal (SIGSTOP)"
            assert heard.why["laser"] == {"why": stopped, "symptom": "halted"}
            laser.signal(signal.SIGCONT)
            await heard.runs({"laser": True})
            laser.kill()
            await heard.runs({"laser": False})
            ended = {"why": f"its process {laser.pid} has ended", "symptom": "ended"}
            assert heard.why["laser"] == ended
            await asyncio.to_thread(ros2.node, "laser")
            await heard.runs({"laser": True})
            assert heard.log == []

    asyncio.run(test())


def test_what_is_wrong_with_a_process_is_known_also_when_nobody_waits_for_it_any_more(tmp_path: Path) -> None:
    with robot(tmp_path, more=soon_lost(tmp_path)) as ros:
        laser = ros.node("laser")

        async def test() -> None:
            async with listening(ros, "nodes", more="discovery_s: 1") as heard:
                await heard.runs({"laser": True})
                laser.signal(signal.SIGSTOP)
                await heard.runs({"laser": False})
                await asyncio.sleep(4)  # longer than its lease: nothing says when
                stopped = f"its process {laser.pid} is stopped by a signal (SIGSTOP)"
                assert heard.why["laser"] == {"why": stopped, "symptom": "halted"}
                laser.kill()
                ended = {"why": f"its process {laser.pid} has ended", "symptom": "ended"}
                await heard.until(lambda: heard.why.get("laser") == ended, "it has ended")
                await asyncio.to_thread(ros.node, "laser")
                await heard.runs({"laser": True})

        asyncio.run(test())


# --- whose process it is ----------------------------------------------------------------------------------


def test_a_process_is_found_by_its_port_with_or_without_its_number(tmp_path: Path) -> None:
    code = (
        "import socket, sys; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(('127.0.0.1', 0)); "
        "print(s.getsockname()[1], flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as peer:
        assert peer.stdout is not None
        port = int(peer.stdout.readline())
        for pid in (peer.pid, 0, os.getpid()):  # its own word, none, another's
            process = find(Participant(b"", "127.0.0.1", port, pid))
            assert process is not None
            assert process.pid == peer.pid
            assert process.works()
        assert find(Participant(b"", "192.0.2.77", port, peer.pid)) is None  # another computer's
        peer.kill()
        peer.wait()
        assert process is not None
        assert not process.works()


def test_a_port_that_nobody_has_open_leads_to_no_process() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    assert find(Participant(b"", "127.0.0.1", port, os.getpid())) is None
    assert find(Participant(b"")) is None
