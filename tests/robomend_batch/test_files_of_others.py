"""Files as other people have them, at the command: each is read right, or it is said that it was not."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from tests.robomend_batch.recordings import EPOCH_NS, KINDS, ROS1, ROS2, Recorder, message
from tests.robomend_batch.rover import told
from tests.robomend_batch.running import batch_run, intervals, logs
from tests.robomend_batch.test_damage import FORMATS, MODEL, OBSERVERS

from robomend_client.observers.base import SECOND

# --- what a log says of a device, as drivers write it ------------------------------------------------------

DEVICE = """
robomend: 1
name: r
nodes: {arm: {publishes: {odom: []}}}
properties: {device: {}, value: {}}
rules: ["not ab(arm) -> ok(device) and ok(value)"]
"""

Status = dict[str, Any]


def status(level: int = 0, name: str = "arm: motor", **values: object) -> Status:
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"level": level, "name": name, "message": "", "hardware_id": "", "values": pairs}


def repeated(*values: object) -> Status:
    """A status in which one key comes several times."""
    return {**status(), "values": [{"key": "value", "value": str(value)} for value in values]}


NONE: set[str] = set()
BAD = {"not ok(value)"}
HOT, COLD = status(value=95), status(value=40)
PLAIN_RULE = "value < 60"

DIAGNOSTICS: dict[str, tuple[list[Status], str, str, set[str]]] = {
    "worst first": ([HOT, COLD], PLAIN_RULE, "arm: *", BAD),
    "worst last": ([COLD, HOT], PLAIN_RULE, "arm: *", BAD),
    "worst of other names": ([status(name="arm: a", value=95), COLD], PLAIN_RULE, "arm: *", BAD),
    "a worse level first": ([status(2), status(0)], PLAIN_RULE, "arm: *", {"not ok(device)"}),
    "a key that repeats": ([repeated(95, 40)], PLAIN_RULE, "arm: *", BAD),
    "a key that repeats otherwise": ([repeated(40, 95)], PLAIN_RULE, "arm: *", BAD),
    "brackets": ([status(name="CPU Usage [robot-c2]", value=95)], PLAIN_RULE, "CPU Usage [robot-c2]", BAD),
    "no class of letters": ([status(2, name="CPU Usage r", value=95)], PLAIN_RULE, "CPU Usage [r]", NONE),
    "hexadecimal": ([status(value="0x1F")], "value != 31", "arm: *", BAD),
    "a comma": ([status(value="39,5")], "value < 39.4", "arm: *", BAD),
    "a comma that is not before tenths": ([status(value="39,5")], "value != 39", "arm: *", NONE),
    "a comma that may be another": ([status(value="1,234")], "value < 0", "arm: *", NONE),
    "false": ([status(value="False")], "value == FALSE", "arm: *", NONE),
    "true": ([status(value="True")], "value == FALSE", "arm: *", BAD),
    "a text": ([status(value="worn")], "value == OK", "arm: *", BAD),
    "not that text": ([status(value="ok")], "value != OK", "arm: *", BAD),
    "without a name": ([status(2, name="")], PLAIN_RULE, "", {"not ok(device)"}),
}


@pytest.mark.parametrize(
    ("topic", "log"),
    [("/diagnostics", "a.mcap"), ("/diagnostics_agg", "a.db3"), ("/robot1/diagnostics", "a.bag")],
)
def test_diagnostics_are_read_as_drivers_write_them(topic: str, log: str, tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text(DEVICE)
    for number, (what, (said, rule, name, expected)) in enumerate(DIAGNOSTICS.items()):
        keys: dict[str, Any] = {"kind": "diagnostic", "status": [name], "rules": [rule], "lifetime_s": 60}
        agent: dict[str, Any] = {"observers": {"device": keys}}
        if topic == "/diagnostics_agg":
            keys["source"] = "diagnostics_agg"
        if topic.startswith("/robot1"):
            agent["ros1"] = {"namespace": "/robot1"}
        (tmp_path / "agent.yaml").write_text(json.dumps(agent))
        record = Recorder(tmp_path / f"{number}{log}")
        record(0, topic, "diagnostic_msgs/msg/DiagnosticArray", status=said)
        record(5, "/odom", "std_msgs/msg/String", data="x")  # the status comes once, and counts
        out = tmp_path / f"out{number}"
        given = record.write(), "--observers", tmp_path / "agent.yaml"
        assert batch_run(out, *given, model=tmp_path / "model.yaml") == 0
        assert {one for interval in intervals(out) for one in interval["observations"]} == expected, what


@pytest.mark.parametrize("log", ["a.bag", "a.mcap", "a.db3"])
def test_two_robots_in_one_recording_are_told_apart(log: str, tmp_path: Path) -> None:
    """Of one robot the arm is broken, of the other the odometry ends; both have the same names."""
    (tmp_path / "model.yaml").write_text(DEVICE)
    record = Recorder(tmp_path / log)
    for n in range(200):
        at_s = n / 10
        for robot in ("one", "two"):
            if robot == "one" or at_s < 10:
                record(at_s, f"/{robot}/odom", "std_msgs/msg/String", data="x")
            level = 2 if robot == "one" and at_s > 5 else 0
            kind = "diagnostic_msgs/msg/DiagnosticArray"
            record(at_s, f"/{robot}/diagnostics", kind, status=[status(level)])
    file = record.write()
    observers = {"device": {"kind": "diagnostic", "status": ["arm: *"]}}
    found = {}
    for robot in ("one", "two", "three"):
        agent = {
            "ros1": {"namespace": robot},
            "topics": {"odom": {"rate_hz": 10, "tolerance_hz": 2}},
            "observers": observers,
        }
        (tmp_path / "agent.yaml").write_text(json.dumps(agent))
        given = file, "--observers", tmp_path / "agent.yaml"
        code = batch_run(tmp_path / robot, *given, model=tmp_path / "model.yaml")
        found[robot] = code, {one for line in intervals(tmp_path / robot) for one in line["observations"]}
    assert found == {"one": (0, {"not ok(device)"}), "two": (0, {"not ok(odom)"}), "three": (2, set())}


@pytest.mark.parametrize("log", ["a.bag", "a.mcap", "stream.mcap", "a.db3"])
@pytest.mark.parametrize("at_s", [0, 20], ids=["first", "last"])
def test_a_message_alone_at_the_beginning_or_the_end_of_a_log_counts(
    at_s: int, log: str, tmp_path: Path
) -> None:
    """A driver's word from before the others were up, or from after they fell silent, is no damage."""
    (tmp_path / "model.yaml").write_text(DEVICE)
    agent = {
        "topics": {"odom": {"rate_hz": 10, "tolerance_hz": 2}},
        "observers": {"device": {"kind": "diagnostic", "status": ["arm: *"], "lifetime_s": 3}},
    }
    (tmp_path / "agent.yaml").write_text(json.dumps(agent))
    record = Recorder(tmp_path / log)
    record(at_s, "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", status=[status(2)])
    for number in range(100):
        record(5 + number / 10, "/odom", "std_msgs/msg/String", data="x")
    file = record.write()
    if log.startswith("stream"):
        messages = [*make_reader(file.open("rb")).iter_messages()]
        with file.open("wb") as opened:
            writer = McapWriter(opened, index_types=IndexType.NONE)
            writer.start(profile="ros2", library="test")
            channels: dict[str, int] = {}
            for schema, channel, one in messages:
                if channel.topic not in channels and schema is not None:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
                writer.add_message(channels[channel.topic], one.log_time, one.data, one.publish_time)
            writer.finish()  # type: ignore[no-untyped-call]  # the library's
    given = file, "--observers", tmp_path / "agent.yaml"
    assert batch_run(tmp_path / "out", *given, model=tmp_path / "model.yaml") == 0
    said = {one for line in intervals(tmp_path / "out") for one in line["observations"]}
    assert said == ({"not ok(device)"} if at_s == 0 else {"not ok(odom)"})
    assert logs(tmp_path / "out")[0]["problems"] == []


# --- messages that are not what a file says of them --------------------------------------------------------


@pytest.fixture
def heater(tmp_path: Path) -> tuple[Path, Path, Path]:
    """Its model, its observers, and those of times alone."""
    model, values, times = (tmp_path / name for name in ("m.yaml", "values.yaml", "times.yaml"))
    model.write_text(MODEL)
    values.write_text(OBSERVERS)
    times.write_text(OBSERVERS.split("observers")[0])
    return model, values, times


DEFINITIONS = {
    "longer": "float64 data\nfloat64[4] more\n",
    "shorter": "float32 data\n",
    "right": "float64 data\n",
    "of the other endianness": "float64 data\n",  # by its messages, which are not
}
SUMS: dict[str, dict[str, str]] = {"bag": {"md5sum": "0" * 32}, "db3": {"rihs01": "RIHS01_" + "0" * 64}}


@pytest.mark.parametrize(
    ("log", "definition"),
    [
        (log, one)
        for log in ("a.bag", "a.mcap", "a.db3")
        for one in DEFINITIONS
        if log != "a.bag" or "of" not in one
    ],
)
def test_messages_that_are_not_as_they_say_are_no_values(
    log: str, definition: str, heater: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    model, values, _ = heater
    file, kind, text = tmp_path / log, KINDS["temperature"], DEFINITIONS[definition]
    samples = [(float(n) / 20, "temperature", float(n)) for n in range(160)]  # it rises throughout
    store = ROS1 if log.endswith(".bag") else ROS2
    bodies = [
        bytes(
            getattr(store, "serialize_ros1" if store is ROS1 else "serialize_cdr")(
                message(store, topic, value, 0, ""), kind
            )
        )
        for _, topic, value in samples
    ]
    if definition == "of the other endianness":
        bodies = [b"\0\0" + body[2:] for body in bodies]
    times = [EPOCH_NS + round(at_s * SECOND) for at_s, *_ in samples]
    if log.endswith(".mcap"):
        with file.open("wb") as opened:
            writer = McapWriter(opened)
            writer.start(profile="ros2", library="test")
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channel = writer.register_channel("/temperature", "cdr", schema)
            for time_ns, body in zip(times, bodies, strict=True):
                writer.add_message(channel, time_ns, body, time_ns)
            writer.finish()  # type: ignore[no-untyped-call]  # the library's
    else:
        folder = tmp_path / "folder"
        bag: Any = Writer1(file) if store is ROS1 else Writer2(folder, version=9)
        with bag:
            of = bag.add_connection("/temperature", kind, msgdef=text, typestore=store, **SUMS[log[2:]])
            for time_ns, body in zip(times, bodies, strict=True):
                bag.write(of, time_ns, body)
        if store is ROS2:
            next(folder.glob("*.db3")).rename(file)
    code = batch_run(tmp_path / "out", file, "--observers", values, model=model)
    (record,) = logs(tmp_path / "out")
    faulty = [bad for _, state, bad in told(tmp_path / "out") if state == "faulty"]
    if definition == "right":
        assert (code, record["state"], faulty) == (0, "ok", [[["heater_node"]]])
    else:
        assert (code, record["state"]) == (2, "bad")
        assert faulty == []  # its rate is judged, its values are not
        assert any("cannot be unpacked" in one["reason"] for one in record["problems"])


# --- files that are damaged in one certain place -----------------------------------------------------------


def test_one_bit_in_the_first_of_many_bz2_chunks_costs_that_chunk(
    heater: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    model, values, _ = heater
    log = tmp_path / "bz2.bag"
    FORMATS["bz2.bag"](log)
    given = log, "--observers", values
    assert batch_run(tmp_path / "whole", *given, model=model) == 0
    data = bytearray(log.read_bytes())
    chunks = [at for at in range(len(data)) if data.startswith(b"BZh9", at)]
    assert len(chunks) >= 8
    data[chunks[0] + 40] ^= 1
    log.write_bytes(data)
    assert batch_run(tmp_path / "out", *given, model=model) == 2
    (record,) = logs(tmp_path / "out")
    assert record["state"] == "bad"
    assert any("chunk at byte" in one["reason"] and "damaged" in one["reason"] for one in record["problems"])
    before, after = told(tmp_path / "whole"), told(tmp_path / "out")
    assert after[0][1] == "unknown"  # the hole
    assert [one for one in after if one[0] > 2.5] == [one for one in before if one[0] > 2.5]
    assert record["span_ns"]["healthy"] > 3 * SECOND


def flips(stamp: bytes) -> list[bytes]:
    """Return a stamp with one bit changed in each of its bytes, and what no stamp is."""
    number = int.from_bytes(stamp, "little")
    return [
        *((number ^ 0x40 << 8 * place).to_bytes(8, "little") for place in range(8)),
        bytes(8),
        b"\xff" * 8,
    ]


@pytest.mark.parametrize(
    ("log", "by_values"),
    [("none.bag", True), ("none.mcap", False), ("none-unchecked.mcap", True), ("none-stream.mcap", False)],
)
def test_a_damaged_stamp_makes_no_fault_of_years(
    log: str, by_values: bool, heater: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    """In an index, and in a message within a chunk, which is what a chunk has as bytes of its own."""
    model, values, times = heater
    file = tmp_path / log
    FORMATS[log](file)
    given = file, "--observers", values if by_values else times
    assert batch_run(tmp_path / "whole", *given, model=model) == 0
    whole = file.read_bytes()
    stamp = EPOCH_NS + 4 * SECOND
    raw = struct.pack("<II", *divmod(stamp, SECOND)) if log.endswith(".bag") else struct.pack("<Q", stamp)
    places = [at for at in range(len(whole) - 8) if whole.startswith(raw, at)]
    assert len(places) >= 2 - ("stream" in log)  # the message's own, and that of the index
    before = [start for start, state, _ in told(tmp_path / "whole") if state == "faulty"]
    for number, (at, other) in enumerate((at, other) for at in places for other in flips(raw)):
        file.write_bytes(whole[:at] + other + whole[at + 8 :])
        out = tmp_path / f"out{number}"
        code = batch_run(out, *given, model=model)
        (record,) = logs(out)
        found = [(start, state) for start, state, _ in told(out)]
        assert all(0 <= start < 9 for start, _ in found), (at, found)
        assert record["end_ns"] < EPOCH_NS + 9 * SECOND
        if code == 0:
            faulty = [start for start, state in found if state == "faulty"]
            assert faulty == pytest.approx(before, abs=0.4), (at, other)
