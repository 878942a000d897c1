"""Topics of a real robot, and what is wrong with those of bad ones."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest
from tests.clients.bridges.hearing import listening
from tests.ros1 import Robot, robot

from robomend_client.bridges.ros1.tcpros import encode_header, frame
from robomend_client.literals import fails, holds
from robomend_client.observers import DiagnosticObserver, HardwareObserver, Wiring

MINE = "my_msgs/Motor"
MINE_TEXT = "Header header\nfloat64 temperature\nPart[] parts\n" + "=" * 80 + (
    "\nMSG: my_msgs/Part\nstring name\nfloat32[3] currents\n" + "=" * 80
    + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
)  # fmt: skip


BOARD_TEXT = "float32 o_time\nChannel[] channel\n" + "=" * 80 + (
    "\nMSG: tug_ist_diagnosis_msgs/Channel\nint32 id\nstring dev_connected\nint32 status\n"
    "float32 current\nfloat32 voltage\n"
)  # fmt: skip


def motor(temperature: float) -> dict[str, Any]:
    return {"temperature": temperature, "parts": [{"name": "left", "currents": [1.0, 2.5, 3.0]}]}


STATUSES = {"type": "diagnostic_msgs/DiagnosticArray", "rate": 20}


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A robot with a good publisher, for all bad ones."""
    with robot(tmp_path_factory.mktemp("laser")) as found:
        found.node("laser").do("publish", topic="/scan", type="std_msgs/String", rate=100)
        yield found


def test_ticks_fields_statuses_and_measurements_come_from_a_real_robot(ros: Robot) -> None:
    node = ros.node("driver")
    node.do("publish", topic="/motor", type=MINE, definition=MINE_TEXT, value=motor(39.5), rate=20)
    status = {"name": "hokuyo: connection", "level": 1, "values": [{"key": "temperature", "value": "39.5"}]}
    aside = ("diagnostics_agg", "r1/diagnostics", "my/state")
    for topic in ("diagnostics", *aside):
        node.do("publish", topic=f"/{topic}", value={"status": [status]}, **STATUSES)
    rows = [
        {"id": 1, "dev_connected": "lamp", "status": 0},
        {"id": 0, "dev_connected": "jaguar", "status": 1, "current": 1.5, "voltage": 24.0},
        {"id": 7, "status": 1},
    ]
    board = {"type": "tug_ist_diagnosis_msgs/DBoardMeasurments", "definition": BOARD_TEXT}
    node.do("publish", topic="/board_measurments", value={"channel": rows}, rate=20, **board)
    node.do("publish", topic="/base/odometry", type="std_msgs/String", rate=20)
    node.do("publish", topic="/r1/laser", type="std_msgs/String", rate=20)
    fields = ("motor:temperature", "motor:parts.0.currents.1", "motor:parts.0.name", "motor:header.seq")
    measured = [
        f"board:{what}" for what in ("current(jaguar)", "voltage(0)", "current(lamp)", "current(fan)")
    ]
    observers = [DiagnosticObserver("hokuyo", ["hokuyo: *"], source=topic) for topic in aside]
    on_topics = [source for one in observers for source in sorted(one.sources)]

    async def test() -> None:
        sources = ("scan", *fields, *measured, "board", "diagnostics", *on_topics)
        async with listening(ros, *sources) as heard:
            for source in (
                "scan",
                "motor:header.seq",
                "board:current(lamp)",
                "board",
                "diagnostics",
                *on_topics,
            ):
                await heard.more(source)
            assert heard.last("scan") is None  # nobody looks into it
            assert [heard.last(field) for field in fields[:3]] == [39.5, 2.5, "left"]
            assert [heard.last(source) for source in measured] == [1.5, 24.0, 0.0, None]
            await heard.told("no current of fan: no channel of the board has a device of that name")
            levels = DiagnosticObserver("hokuyo", ["hokuyo: *"], ["temperature < 39"])
            levels.feed("diagnostics", 1, heard.last("diagnostics"))
            assert levels.check(1) == (fails("ok", "hokuyo"), fails("ok", "temperature"))
            for one in observers:
                for source in one.sources:
                    one.feed(source, 1, heard.last(source))
                assert one.check(1) == (fails("ok", "hokuyo"),)
            hardware = HardwareObserver({"jaguar": Wiring(0), "lamp": Wiring(1), "far": Wiring(7)})
            hardware.feed("board", 1, heard.last("board"))
            assert hardware.check(1) == (holds("on", "jaguar"), fails("on", "lamp"))
            assert len(heard.log) == 2, heard.log  # the master knows us, and there is no fan
        more = "namespace: /r1\nnames: {odom: /base/odometry}"
        async with listening(ros, "diagnostics", "laser", "odom", more=more) as heard:
            for source in ("diagnostics", "laser", "odom"):
                await heard.more(source)
            assert heard.last("diagnostics")[0]["name"] == "hokuyo: connection"

    asyncio.run(test())


def test_publishers_that_come_late_come_again_or_change_their_type_are_heard(ros: Robot) -> None:
    late = {"topic": "/late", "type": "std_msgs/String", "rate": 20}
    changed = {"topic": "/motors", "type": "my_msgs/Motor", "rate": 20}
    old_value, new_value = {"volts": 24.0}, {"amperes": 1.0, "volts": 12.0}

    async def test() -> None:
        async with listening(ros, "late", "x", "x:data", "motors:volts") as heard:
            await heard.told("is known to the master")
            node = await asyncio.to_thread(ros.node, "changeable")
            await asyncio.to_thread(node.do, "publish", **late)
            await heard.more("late")
            await asyncio.to_thread(node.do, "unpublish", topic="/late")
            await asyncio.to_thread(node.do, "publish", **late)
            await heard.more("late")
            number = {"type": "std_msgs/Float64", "value": {"data": 1.0}}
            await asyncio.to_thread(node.do, "publish", topic="/x", rate=20, **number)
            await asyncio.to_thread(
                node.do, "publish", definition="float64 volts\n", value=old_value, **changed
            )
            await heard.more("x:data")
            await heard.until(lambda: heard.last("motors:volts") == 24.0, "by the old definition")
            node.kill()
            other = await asyncio.to_thread(ros.node, "other")
            await asyncio.to_thread(other.do, "publish", **late)
            await heard.more("late")
            mine = {"type": MINE, "definition": MINE_TEXT, "value": motor(1)}
            await asyncio.to_thread(other.do, "publish", topic="/x", rate=20, **mine)
            await heard.told("/other publishes my_msgs/Motor")
            await heard.more("x")
            text = "float64 amperes\nfloat64 volts\n"
            await asyncio.to_thread(other.do, "publish", definition=text, value=new_value, **changed)
            await heard.until(lambda: heard.last("motors:volts") == 12.0, "by the new definition")
            assert set(heard.values["motors:volts"]) == {24.0, 12.0}
            for said in ("where std_msgs/Float64", "where my_msgs/Motor", "no field data"):
                assert len(heard.lines(said)) == 1, said

    asyncio.run(test())


# --- peers that no distribution has: these are played, everything else is real -----------------------------


class _Quiet(SimpleXMLRPCRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def publisher(master: str, name: str, answer: Any, says: bytes = b"") -> Iterator[None]:
    """Register a publisher of a topic of its name that answers requestTopic so, and says these bytes to
    whoever connects.
    """
    with socket.create_server(("127.0.0.1", 0)) as messages:
        where = answer or [1, "", ["TCPROS", "127.0.0.1", messages.getsockname()[1]]]
        with SimpleXMLRPCServer(("127.0.0.1", 0), _Quiet, logRequests=False) as server:
            server.register_function(lambda *_: where, "requestTopic")
            threading.Thread(target=server.serve_forever, daemon=True).start()
            threading.Thread(target=_say, args=(messages, says), daemon=True).start()
            _register(master, name, f"http://127.0.0.1:{server.server_address[1]}/")
            yield
            server.shutdown()


def _say(messages: socket.socket, says: bytes) -> None:
    while True:
        try:
            connection, _ = messages.accept()
        except OSError:
            return
        with connection:
            connection.sendall(says)
            connection.recv(4096)
            connection.recv(4096)


def _register(master: str, name: str, uri: str) -> None:
    api: Any = ServerProxy(master)
    code, why, _ = api.registerPublisher(name, name, "std_msgs/String", uri)
    assert code == 1, why


HEADER = {"callerid": "/bad", "type": "std_msgs/Float64", "md5sum": "fdb28210bfa9d7c91146260178d9a584"}
GREETING = encode_header({**HEADER, "message_definition": "float64 data\n"})


BAD_PEERS: list[tuple[Any, bytes, str]] = [
    (None, b"HTTP/1.1 400 Bad Request\r\n\r\n", "TCPROS: a header that is too long: 1347703880 bytes"),
    (None, GREETING + frame(b"abc"), "by /bad cannot be read: it is 5 bytes shorter than its type"),
    (None, GREETING + b"\xff\xff\xff\xff", "a message that is too long: 4294967295 bytes"),
    (
        None,
        encode_header({**HEADER, "message_definition": "float64[[ data"}) + frame(b"12345678"),
        "the definition of std_msgs/Float64 by /bad cannot be read",
    ),
    (None, encode_header({"error": "not you"}), "it refuses: not you"),
    ([0, "no such topic", []], b"", "it does not publish /bad5: no such topic"),
    ([1, "", ["UDPROS", 3]], b"", "requestTopic was answered with"),
    ([1, "", ["TCPROS", "no-such.invalid", 1]], b"", "the host name 'no-such.invalid' is unknown"),
]


def test_bad_peers_are_told_once_each_with_their_place_and_survived(ros: Robot) -> None:
    async def test() -> None:
        names = [f"bad{number}" for number in range(len(BAD_PEERS))]
        with ExitStack() as there:
            for name, (answer, says, _) in zip(names, BAD_PEERS, strict=True):
                there.enter_context(publisher(ros.master.uri, f"/{name}", answer, says))
            async with listening(ros, "scan", *(f"{name}:data" for name in names)) as heard:
                for _, _, why in BAD_PEERS:
                    await heard.told(why)
                await heard.more("scan", 40)  # time for two tries more
                for _, _, why in BAD_PEERS:
                    (line,) = heard.lines(why)
                    assert "/bad" in line or "http://" in line

    asyncio.run(test())


def test_an_unreachable_publisher_is_told_with_what_to_look_at(ros: Robot) -> None:
    _register(ros.master.uri, "/far", "http://no-such-robot.invalid:4711/")

    async def test() -> None:
        async with listening(ros, "far") as heard:
            await heard.told("the host name 'no-such-robot.invalid' is unknown")
            (line,) = heard.lines("no-such-robot")
            assert "the publisher at http://no-such-robot.invalid:4711/" in line
            assert "is ROS_IP or ROS_HOSTNAME right" in line

    asyncio.run(test())
