"""Who runs on a real ROS 1, and which services answer: killed, frozen, ended, started again."""

from __future__ import annotations

import asyncio
import signal
import socket
from typing import Any
from xmlrpc.client import ServerProxy, dumps

import pytest
from tests.clients.bridges.hearing import listening
from tests.ros1 import Robot
from tests.waiting import eventually

from robomend_client.bridges.ros1 import master
from robomend_client.bridges.ros1.liveness import Nodes, NodeState

ANSWERS, NOBODY, FAR, ODD = (
    f"services:{name}" for name in ("frozen/get_loggers", "nobody/knows", "far/away", "odd/one")
)
ODD_NAMES = ("/a b", "/käse", "/2nd", "/x; reboot", "/{{}}")
LONG_NAME = "y" * 500  # and a name


def register_odd_ones(uri: str, port: int) -> None:
    """Tell the master of nodes and services that no distribution would have."""
    api: Any = ServerProxy(uri)
    for name in (*ODD_NAMES, f"/{LONG_NAME}"):
        assert api.registerSubscriber(name, "/nothing", "std_msgs/String", "http://127.0.0.1:9/")[0] == 1
    for name, where in (("/far/away", "no-such-robot.invalid:4711"), ("/odd/one", f"127.0.0.1:{port}")):
        assert api.registerService("/somebody", name, f"rosrpc://{where}", "http://127.0.0.1:1/")[0] == 1


def test_nodes_and_services_are_seen_to_begin_freeze_go_on_and_end(ros1: Robot) -> None:
    killed, frozen, ends, stays = (ros1.node(name) for name in ("killed", "frozen", "ends", "stays"))
    ros1.node("elsewhere", ROS_HOSTNAME="no-such-robot.invalid", ROS_IP="")
    stays.do("publish", topic="/scan", type="std_msgs/String", rate=20)

    async def garbage(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        writer.close()

    async def test() -> None:
        server = await asyncio.start_server(garbage, "127.0.0.1", 0, family=socket.AF_INET)
        port = server.sockets[0].getsockname()[1]
        await asyncio.to_thread(register_odd_ones, ros1.master.uri, port)
        # /rosout is the bridge's own business, and an observer's
        async with listening(ros1, "nodes", "scan", "rosout", ANSWERS, NOBODY, FAR, ODD) as heard:
            well = dict.fromkeys(("killed", "frozen", "ends", "stays"), True)
            await heard.runs({**well, "elsewhere": None, LONG_NAME: False})
            for said in (
                "the host name 'no-such-robot.invalid' is unknown here; whether it runs is unknown",
                "the node '/a b': ROS allows no such name",
                "the service /far/away: the host name 'no-such-robot.invalid' is unknown here",
                "/odd/one: it does not say who it is: a header that is too long: 1347703880 bytes",
            ):
                await heard.told(said)
            answers = (True, False, False)
            await heard.until(
                lambda: (heard.last(ANSWERS), heard.last(NOBODY), heard.last(ODD)) == answers, "services"
            )
            killed.kill()
            await heard.runs({"killed": False, "frozen": True})
            assert heard.why["killed"]["symptom"] == "ended"
            frozen.signal(signal.SIGSTOP)
            await heard.runs({"frozen": False})
            halted = f"its process {frozen.pid} is stopped by a signal (SIGSTOP)"
            assert heard.why["frozen"] == {"why": halted, "symptom": "halted"}
            await heard.until(lambda: heard.last(ANSWERS) is False, "its service is frozen, too")
            await heard.told("/frozen/get_loggers: it does not say who it is: nothing within 1 s")
            frozen.signal(signal.SIGCONT)
            await heard.runs({"frozen": True})
            await heard.until(lambda: heard.last(ANSWERS) is True, "its service answers again")
            await heard.more("scan")
            await asyncio.to_thread(stays.do, "log", level="warning", text="as asked")
            await heard.until(lambda: heard.count("rosout"), "a message of /rosout")
            await asyncio.to_thread(stays.do, "unpublish", topic="/scan")
            await asyncio.to_thread(ends.do, "leave")
            await heard.runs({"ends": False})
            await asyncio.to_thread(ros1.node, "killed")
            await heard.runs({"killed": True, "elsewhere": None})
            assert all(table.get("stays") is not False for table in heard.values["nodes"])
            assert {name[1:] for name in ODD_NAMES} <= {name for t in heard.values["nodes"] for name in t}
            assert len(heard.lines("ROS allows no such name")) == len(ODD_NAMES)
            assert heard.count(FAR) == 0
        server.close()

    asyncio.run(test())


def test_a_master_that_is_frozen_or_starts_anew_is_told_once_and_hides_no_node_that_ends(
    ros1: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(master, "CALL_S", 2.0)
    killed, steady = ros1.node("killed"), ros1.node("steady")
    steady.do("publish", topic="/scan", type="std_msgs/String", rate=20)

    async def test() -> None:
        # Whoever is killed is found by its connection, before it would be asked.
        async with listening(ros1, "nodes", "scan", "odom", more="ping_s: 60") as heard:
            await heard.runs({"killed": True, "steady": True})
            await heard.more("scan")
            ros1.master.signal(signal.SIGSTOP)
            await heard.told("the master: lookupNode was not answered within 2 s")
            killed.kill()
            await eventually(lambda: heard.last("nodes").get("killed") is False, "that it is gone", 40)
            await heard.more("scan")
            assert len(heard.lines("the master: ")) == 1
            ros1.master.signal(signal.SIGCONT)
            await heard.told("the master: well again")
            ros1.master.stop()
            await heard.told("the master: nobody listens")
            await heard.more("scan")  # the old publisher goes on, master or not
            known = len(heard.lines("is known to the master"))
            await asyncio.to_thread(ros1.master.start)
            await heard.until(lambda: len(heard.lines("is known to the master")) > known, "it knows us anew")
            node = await asyncio.to_thread(ros1.node, "new")
            await asyncio.to_thread(node.do, "publish", topic="/odom", type="std_msgs/String", rate=20)
            await heard.more("odom")
            await heard.more("scan")
            assert len(heard.lines("the master: nobody listens")) == 1
            assert all(table.get("steady") is not False for table in heard.values["nodes"])
            steady.kill()
            await heard.runs({"steady": False, "new": True})

    asyncio.run(test())


@pytest.mark.timeout(300)  # a whole session
def test_a_node_that_answers_late_runs_and_one_that_never_answers_is_frozen(ros1: Robot) -> None:
    answer = dumps(([1, "", 4711],), methodresponse=True).encode()
    slow, answered = "/slow", asyncio.Semaphore(0)

    async def late(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"</methodCall>")
        await asyncio.sleep(2.0)  # longer than it has
        writer.write(b"HTTP/1.0 200 OK\r\nContent-Length: %d\r\n\r\n" % len(answer) + answer)
        writer.close()
        answered.release()

    async def never(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        writer.close()

    def register(name: str, port: int) -> None:
        api: Any = ServerProxy(ros1.master.uri)
        uri = f"http://127.0.0.1:{port}/"
        assert api.registerSubscriber(name, "/nothing", "std_msgs/String", uri)[0] == 1

    async def test() -> None:
        servers = [await asyncio.start_server(one, "127.0.0.1", 0) for one in (late, never)]
        for name, server in zip((slow, "/deaf"), servers, strict=True):
            await asyncio.to_thread(register, name, server.sockets[0].getsockname()[1])
        async with listening(ros1, "nodes") as heard:
            await heard.runs({"slow": True, "deaf": False})
            assert heard.why["deaf"]["why"].startswith("does not answer for ")
            assert heard.why["deaf"]["symptom"] == "halted"
            for _ in range(3):
                await asyncio.wait_for(answered.acquire(), 60)
            assert all(table.get("slow", True) is not False for table in heard.values["nodes"])
        for server in servers:
            server.close()

    asyncio.run(test())


# --- by what is seen of them ------------------------------------------------------------------------------


def test_what_is_read_of_a_node_that_is_gone_was_said_before_unless_it_connects_anew() -> None:
    nodes = Nodes()
    nodes.linked("/a", "http://a:1/", 0.0)
    nodes.asked("/a", NodeState.GONE, 1.0)
    assert not nodes.heard("/a", 1.1)
    assert nodes.table() == {"/a": False}
    assert nodes.heard("/a", 1.2)  # nobody listens at its address, and it goes on
    nodes.asked("/a", NodeState.GONE, 2.0)
    assert nodes.linked("/a", "http://a:2/", 2.1)
    assert not nodes.heard("/a", 2.11)
    assert nodes.table() == {"/a": True}
    assert nodes.silent(2.6, 0.5) == frozenset()


def test_a_master_that_forgot_a_node_does_not_stop_it() -> None:
    nodes = Nodes()
    nodes.linked("/linked", "http://a:1/", 0.0)
    nodes.listed(frozenset({"/linked", "/answers"}))
    nodes.asked("/answers", NodeState.RUNNING, 0.0)
    nodes.listed(frozenset())
    assert nodes.table() == {"/linked": True, "/answers": True}
    nodes.asked("/answers", NodeState.GONE, 1.0)
    nodes.listed(frozenset())
    assert nodes.table() == {"/linked": True}


def test_who_was_not_heard_is_asked() -> None:
    nodes = Nodes()
    nodes.linked("/a", "http://a:1/", 0.0)
    nodes.linked("/b", "http://b:1/", 0.9)
    assert nodes.silent(1.0, 0.75) == {"/a"}
    nodes.asked("/a", NodeState.FROZEN, 1.0)
    assert nodes.silent(1.5, 0.75) == frozenset()
