"""A whole agent under a real robot: from its file to the service, which a double plays."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually
from tests.other_computer import OtherComputer, other_computer
from tests.ros1 import Robot, robot
from tests.waiting import eventually as eventually_soon

from robomend_client.bridges.ros1.xmlrpc import connect, is_delivered


@contextmanager
def watching(
    folder: Path, service: ServiceDouble, ros: Robot, bridge: dict[str, Any] | None = None, **more: Any
) -> Iterator[subprocess.Popen[bytes]]:
    section = {"master": ros.master.uri, **(bridge or {})}
    with agent(config(folder, service.url, {}, ros1=section, **more)) as process:
        yield process


def test_peers_that_speak_garbage_to_the_agent_are_told_once_with_their_computer_and_others_are_served(
    ros1: Robot, service: ServiceDouble, tmp_path: Path
) -> None:
    def say(port: int, *data: bytes) -> None:
        for one in data:
            with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
                connection.sendall(one)
                connection.shutdown(socket.SHUT_WR)
                with contextlib.suppress(ConnectionResetError):
                    while connection.recv(4096):
                        pass

    section = {"topics": {"scan": {"from": "ros1"}}}
    with watching(tmp_path, service, ros1, **section):
        master: Any = ServerProxy(ros1.master.uri)
        eventually(lambda: master.lookupNode("/test", "/robomend_onboard")[0] == 1, "the agent's node", 60)
        uri = master.lookupNode("/test", "/robomend_onboard")[2]
        node: Any = ServerProxy(uri)
        port = node.requestTopic("/test", "/observations", [["TCPROS"]])[2][2]
        http = b"POST / HTTP/1.0\r\nContent-Length: 4\r\n\r\nwhat"
        say(int(uri.rstrip("/").rpartition(":")[2]), http, http, b"\x16\x03\x01 no head", b"")
        say(port, b"GET / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", b"\x04\0\0\0\xff\0\0\0")
        assert node.getPid("/test")[0] == 1  # it goes on
        watcher = ros1.node("watcher")
        definition = "float32 out_time\nstring[] obs\n"
        kind = "tug_ist_diagnosis_msgs/Observations"
        watcher.do("subscribe", topic="/observations", type=kind, definition=definition)
        eventually(lambda: watcher.heard, "one that speaks as it should", 60)
    log = (tmp_path / "agent.log").read_text()
    for place, first in (
        ("a caller at 127.0.0.1: ", "it speaks no XML-RPC: syntax error"),
        ("a subscriber at 127.0.0.1: ", "it speaks no TCPROS: a header that is too long: 542393671 bytes"),
    ):
        assert log.count(place) == log.count(place + first) == 1, (place, log)


def test_without_its_master_nothing_is_said_of_nodes(
    ros1: Robot, service: ServiceDouble, tmp_path: Path
) -> None:
    ros1.master.stop()
    observers = {"n": {"kind": "node", "from": "ros1", "preset": "ros1"}}
    with watching(tmp_path, service, ros1, observers=observers) as process:
        log = tmp_path / "agent.log"
        eventually(lambda: "the master: nobody listens" in log.read_text(), "a complaint", 60)
        eventually(lambda: service.polls, "an agent that works", 60)
        assert process.poll() is None
    assert service.holds() == {}


def test_of_the_nodes_behind_a_split_network_it_is_unknown_whether_they_run_until_it_is_whole_again(
    service: ServiceDouble, tmp_path: Path, long: bool
) -> None:
    observations = {
        "type": "tug_ist_diagnosis_msgs/Observations",
        "definition": "float32 out_time\nstring[] obs\n",
    }
    sections: dict[str, Any] = {
        "topics": {"scan": {"from": "ros1", "first_s": 60}},
        "observers": {
            name: {"kind": "node", "from": "ros1", "preset": "ros1"} for name in ("laser", "silent", "near")
        },
    }
    nodes = {"running(laser)", "running(silent)"}
    log = tmp_path / "agent.log"
    with other_computer() as computer, robot(tmp_path, computer.there, computer.inside) as ros:
        laser, watcher = ros.node("laser"), ros.node("watcher")
        ros.node("silent")
        ros.node("near", (), ROS_IP=computer.here)  # on the agent's own side
        laser.do("publish", topic="/scan", type="std_msgs/String", rate=10)
        watcher.do("subscribe", topic="/observations", **observations)
        with watching(tmp_path, service, ros, **sections):
            well = dict.fromkeys(nodes | {"running(near)", "ok(scan)"}, True)
            eventually(lambda: well.items() <= service.signs().items(), "a robot that is well", 60)
            eventually(lambda: watcher.heard, "the agent at the other side", 60)
            computer.cut()
            eventually(lambda: all(service.signs()[node] is None for node in nodes), "unknown", 60)
            eventually(lambda: "the master: " in log.read_text(), "a complaint", 60)
            if long:  # until the connections are given up
                eventually(lambda: "the publisher at http" in log.read_text(), "lost connections", 60)
            split = log.read_text()
            assert service.signs()["running(near)"]
            computer.mend()
            eventually(lambda: well.items() <= service.signs().items(), "all well again", 60)
            eventually(lambda: log.read_text().count("is known to the master") == 2, "all anew", 60)
            before = len(watcher.heard)
            eventually(lambda: len(watcher.heard) > before, "the agent is heard again", 60)
    told = [batch["observations"] for batch in service.batches()]
    assert not any("running(near)" in batch.get("unknown", ()) for batch in service.batches())
    assert not any(f"not {node}" in said for said in told for node in nodes)
    assert split.count("ROS 1, the master: ") == 1
    assert split.count("whether it runs is unknown") == 3  # of the watcher, too
    for place in ("the master", "/laser", "/silent"):
        assert log.read_text().count(f"ROS 1, {place}: well again") == 1


def test_whether_a_question_has_got_to_the_other_computer_is_told_from_whether_it_is_answered() -> None:
    listens = "import socket, sys; s = socket.create_server((sys.argv[1], 0)); "
    listens += "print(s.getsockname()[1], flush=True); sys.stdin.read()"

    async def test(computer: OtherComputer, port: int) -> None:
        heard, lost = [await connect(computer.there, port, 30) for _ in range(2)]
        heard[1].write(b"a question")
        await eventually_soon(lambda: is_delivered(heard), "the other computer confirms it", 30)
        computer.cut()
        lost[1].write(b"a question")
        assert not is_delivered(lost)
        assert is_delivered(heard)
        computer.mend()
        await eventually_soon(lambda: is_delivered(lost), "it is sent again", 30)
        for _, writer in (heard, lost):
            writer.close()

    with other_computer() as computer:
        command = [*computer.inside, sys.executable, "-c", listens, computer.there]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            try:
                asyncio.run(test(computer, int(process.stdout.readline())))
            finally:
                process.kill()
