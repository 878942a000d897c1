"""Topics of a real robot, and what is wrong with those of bad ones."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest
from tests.clients.bridges.ros1.listening import hearing
from tests.ros1 import Robot, robot
from tests.waiting import eventually

from robomend_client.bridges.ros1.tcpros import encode_header, frame
from robomend_client.literals import fails, holds
from robomend_client.observers import DiagnosticObserver, HardwareObserver, Wiring

TWIST = "geometry_msgs/Twist"
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


def test_ticks_and_fields_of_any_type_come_from_a_real_robot(ros: Robot, tmp_path: Path) -> None:
    node = ros.node("motor_node")
    node.do("publish", topic="/scan", type="std_msgs/String", value={"data": "x" * 100}, rate=20)
    node.do("publish", topic="/motor", type=MINE, definition=MINE_TEXT, value=motor(39.5), rate=20)

    async def test() -> None:
        fields = ("motor:temperature", "motor:parts.0.currents.1", "motor:parts.0.name", "motor:header.seq")
        async with hearing(tmp_path, ros.master.uri, "scan", *fields) as heard:
            await heard.more("scan")
            await heard.more("motor:header.seq")
            assert heard.last("scan") is None  # nobody looks into it
            assert heard.last("motor:temperature") == 39.5
            assert heard.last("motor:parts.0.currents.1") == 2.5
            assert heard.last("motor:parts.0.name") == "left"
            assert heard.log == heard.lines("is known to the master")

    asyncio.run(test())


def test_late_publishers_are_found_and_those_that_go_come_again(ros: Robot, tmp_path: Path) -> None:
    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "scan") as heard:
            await heard.told("is known to the master")
            node = await asyncio.to_thread(ros.node, "laser")
            scan = {"topic": "/scan", "type": "std_msgs/String", "rate": 20}
            await asyncio.to_thread(node.do, "publish", **scan)
            await heard.more("scan")
            await asyncio.to_thread(node.do, "unpublish", topic="/scan")
            await asyncio.to_thread(node.do, "publish", **scan)
            await heard.more("scan")
            node.kill()
            again = await asyncio.to_thread(ros.node, "laser")
            await asyncio.to_thread(again.do, "publish", **scan)
            await heard.more("scan")

    asyncio.run(test())


def test_a_master_that_restarts_is_told_everything_anew(ros: Robot, tmp_path: Path) -> None:
    scan = {"topic": "/scan", "type": "std_msgs/String", "rate": 20}
    ros.node("old").do("publish", **scan)

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "scan", "odom") as heard:
            await heard.more("scan")
            ros.master.stop()
            await heard.told("nobody listens")
            await heard.more("scan")  # the old publisher goes on, master or not
            await asyncio.to_thread(ros.master.start)
            await eventually(lambda: len(heard.lines("is known to the master")) == 2, "a second time", 60)
            await heard.more("scan")
            node = await asyncio.to_thread(ros.node, "new")
            await asyncio.to_thread(node.do, "publish", **{**scan, "topic": "/odom"})
            await heard.more("odom")
            assert len(heard.lines("the master: nobody listens")) == 1

    asyncio.run(test())


def test_a_topic_that_changes_its_type_is_told_and_heard_on(ros: Robot, tmp_path: Path) -> None:
    node = ros.node("changeable")
    node.do("publish", topic="/x", type="std_msgs/Float64", value={"data": 1.0}, rate=20)

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "x", "x:data") as heard:
            await heard.more("x:data")
            await asyncio.to_thread(node.do, "unpublish", topic="/x")
            other = await asyncio.to_thread(ros.node, "other")
            await asyncio.to_thread(
                other.do, "publish", topic="/x", type=MINE, definition=MINE_TEXT, value=motor(1), rate=20
            )
            await heard.told("where std_msgs/Float64")
            await heard.more("x")
            assert len(heard.lines("where std_msgs/Float64")) == 1
            assert "/other publishes my_msgs/Motor" in heard.lines("where std_msgs/Float64")[0]
            assert len(heard.lines("no field data")) == 1

    asyncio.run(test())


def test_a_topic_that_changes_its_md5sum_alone_is_told_and_read_by_the_new_definition(
    ros: Robot, tmp_path: Path
) -> None:
    old, new = ros.node("old"), ros.node("new")
    motor = {"topic": "/motor", "type": "my_msgs/Motor", "rate": 20}
    old.do("publish", definition="float64 volts\n", value={"volts": 24.0}, **motor)

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "motor", "motor:volts") as heard:
            await heard.until(lambda: heard.last("motor:volts") == 24.0, "by the old definition")
            await asyncio.to_thread(old.do, "unpublish", topic="/motor")
            value = {"amperes": 1.0, "volts": 12.0}
            text = "float64 amperes\nfloat64 volts\n"
            await asyncio.to_thread(new.do, "publish", definition=text, value=value, **motor)
            await heard.until(lambda: heard.last("motor:volts") == 12.0, "by the new definition")
            (told,) = heard.lines("/new publishes my_msgs/Motor")
            assert "where my_msgs/Motor" in told
            assert set(heard.values["motor:volts"]) == {24.0, 12.0}

    asyncio.run(test())


def test_diagnostics_and_the_boards_channels_come_as_observers_read_them(ros: Robot, tmp_path: Path) -> None:
    node = ros.node("driver")
    status = {
        "name": "hokuyo: connection",
        "level": 1,
        "values": [{"key": "temperature", "value": "39.5"}],
    }
    diagnostics = {"status": [status]}
    node.do(
        "publish", topic="/diagnostics", type="diagnostic_msgs/DiagnosticArray", value=diagnostics, rate=20
    )
    rows = [{"id": 1, "status": 0}, {"id": 0, "status": 1, "current": 1.5}, {"id": 7, "status": 1}]
    board = {"type": "tug_ist_diagnosis_msgs/DBoardMeasurments", "definition": BOARD_TEXT}
    node.do("publish", topic="/board_measurments", value={"channel": rows}, rate=20, **board)

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "diagnostics", "board") as heard:
            await heard.more("diagnostics")
            await heard.more("board")
            levels = DiagnosticObserver("hokuyo", ["hokuyo: *"], ["temperature < 39"])
            levels.feed("diagnostics", 1, heard.last("diagnostics"))
            assert levels.check(1) == (fails("ok", "hokuyo"), fails("ok", "temperature"))
            wiring = {"jaguar": Wiring(0), "lamp": Wiring(1), "far": Wiring(7)}
            hardware = HardwareObserver(wiring)
            hardware.feed("board", 1, heard.last("board"))
            assert hardware.check(1) == (holds("on", "jaguar"), fails("on", "lamp"))

    asyncio.run(test())


@pytest.mark.parametrize(
    ("topic", "source"),
    [
        ("/diagnostics_agg", "diagnostics_agg"),
        ("/r1/diagnostics", "r1/diagnostics"),
        ("/my/state", "my/state"),
    ],
)
def test_statuses_are_heard_on_whatever_topic_they_are(
    ros: Robot, tmp_path: Path, topic: str, source: str
) -> None:
    array = {"status": [{"name": "hokuyo: connection", "level": 1, "values": []}]}
    node = ros.node("driver")
    node.do("publish", topic=topic, type="diagnostic_msgs/DiagnosticArray", value=array, rate=20)

    async def test() -> None:
        levels = DiagnosticObserver("hokuyo", ["hokuyo: *"], source=source)
        async with hearing(tmp_path, ros.master.uri, *levels.sources) as heard:
            for one in levels.sources:
                await heard.more(one)
                levels.feed(one, 1, heard.last(one))
            assert levels.check(1) == (fails("ok", "hokuyo"),)

    asyncio.run(test())


def test_diagnostics_that_were_remapped_into_a_namespace_are_heard(ros: Robot, tmp_path: Path) -> None:
    array = {"status": [{"name": "hokuyo: connection", "level": 1, "values": []}]}
    node = ros.node("driver")
    node.do("publish", topic="/r1/diagnostics", type="diagnostic_msgs/DiagnosticArray", value=array, rate=20)

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "diagnostics", more="namespace: /r1") as heard:
            await heard.more("diagnostics")
            assert heard.last("diagnostics")[0]["name"] == "hokuyo: connection"

    asyncio.run(test())


def test_what_the_board_measures_of_a_device_is_a_number_for_any_observer(ros: Robot, tmp_path: Path) -> None:
    rows = [
        {"id": 7, "dev_connected": "jaguar", "status": 1, "current": 1.5, "voltage": 24.0},
        {"id": 3, "dev_connected": "lamp"},
    ]
    board = {"type": "tug_ist_diagnosis_msgs/DBoardMeasurments", "definition": BOARD_TEXT}
    ros.node("board").do("publish", topic="/board_measurments", value={"channel": rows}, rate=20, **board)
    sources = [f"board:{what}" for what in ("current(jaguar)", "voltage(7)", "current(lamp)", "current(fan)")]

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, *sources) as heard:
            await heard.more("board:current(lamp)")
            assert [heard.last(source) for source in sources] == [1.5, 24.0, 0.0, None]
            await heard.told("no current of fan: no channel of the board has a device of that name")
            await heard.more("board:voltage(7)")
            assert len(heard.lines("no current of fan")) == 1

    asyncio.run(test())


# --- peers that no distribution has: these are played, everything else is real -----------------------------


class _Quiet(SimpleXMLRPCRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def publisher(master: str, topic: str, answer: Any, says: bytes = b"") -> Iterator[None]:
    """Register a publisher that answers requestTopic so, and says these bytes to whoever connects."""
    with socket.create_server(("127.0.0.1", 0)) as messages:
        where = answer or [1, "", ["TCPROS", "127.0.0.1", messages.getsockname()[1]]]
        with SimpleXMLRPCServer(("127.0.0.1", 0), _Quiet, logRequests=False) as server:
            server.register_function(lambda *_: where, "requestTopic")
            uri = f"http://127.0.0.1:{server.server_address[1]}/"
            threading.Thread(target=server.serve_forever, daemon=True).start()
            threading.Thread(target=_say, args=(messages, says), daemon=True).start()
            _register(master, topic, uri)
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


def _register(master: str, topic: str, uri: str) -> None:
    api: Any = ServerProxy(master)
    code, why, _ = api.registerPublisher("/bad", topic, "std_msgs/String", uri)
    assert code == 1, why


@pytest.fixture(scope="module")
def laser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A robot with a good publisher, for all bad ones."""
    with robot(tmp_path_factory.mktemp("laser")) as found:
        found.node("laser").do("publish", topic="/scan", type="std_msgs/String", rate=100)
        yield found


HEADER = {"callerid": "/bad", "type": "std_msgs/Float64", "md5sum": "fdb28210bfa9d7c91146260178d9a584"}
GREETING = encode_header({**HEADER, "message_definition": "float64 data\n"})


@pytest.mark.parametrize(
    ("answer", "says", "why"),
    [
        (None, b"HTTP/1.1 400 Bad Request\r\n\r\n", "TCPROS: a header that is too long: 1347703880 bytes"),
        (None, GREETING + frame(b"abc"), "by /bad cannot be read: it is 5 bytes shorter than its type"),
        (None, GREETING + b"\xff\xff\xff\xff", "a message that is too long: 4294967295 bytes"),
        (None, encode_header({**HEADER, "message_definition": "float64[[ data"}) + frame(b"12345678"),
         "the definition of std_msgs/Float64 by /bad cannot be read"),
        (None, encode_header({"error": "not you"}), "it refuses: not you"),
        ([0, "no such topic", []], b"", "it does not publish /bad: no such topic"),
        ([1, "", ["UDPROS", 3]], b"", "requestTopic was answered with"),
        ("what?", b"", "requestTopic was answered with"),
        ([1, "", ["TCPROS", "no-such.invalid", 1]], b"", "the host name 'no-such.invalid' is unknown"),
    ],
)  # fmt: skip
def test_a_bad_peer_is_told_once_with_its_place_and_survived(
    laser: Robot, tmp_path: Path, answer: Any, says: bytes, why: str
) -> None:
    async def test() -> None:
        async with hearing(tmp_path, laser.master.uri, "bad:data", "scan") as heard:
            with publisher(laser.master.uri, "/bad", answer, says):
                await heard.told(why)
                await heard.more("scan", 40)  # time for two tries more
                (line,) = heard.lines(why)
                assert "/bad" in line or "http://" in line

    asyncio.run(test())


def test_an_unreachable_publisher_is_told_with_what_to_look_at(ros: Robot, tmp_path: Path) -> None:
    _register(ros.master.uri, "/scan", "http://no-such-robot.invalid:4711/")

    async def test() -> None:
        async with hearing(tmp_path, ros.master.uri, "scan") as heard:
            await heard.told("the host name 'no-such-robot.invalid' is unknown")
            (line,) = heard.lines("no-such-robot")
            assert "the publisher at http://no-such-robot.invalid:4711/" in line
            assert "is ROS_IP or ROS_HOSTNAME right" in line

    asyncio.run(test())


def test_names_of_the_model_are_found_in_a_namespace_and_by_the_file(ros: Robot, tmp_path: Path) -> None:
    node = ros.node("talker")
    for topic in ("/robot1/scan", "/base/odometry"):
        node.do("publish", topic=topic, type="std_msgs/String", rate=20)

    async def test() -> None:
        more = "namespace: /robot1\nnames: {odom: /base/odometry}"
        async with hearing(tmp_path, ros.master.uri, "scan", "odom", more=more) as heard:
            await heard.more("scan")
            await heard.more("odom")

    asyncio.run(test())
