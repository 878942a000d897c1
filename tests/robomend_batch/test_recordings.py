"""From recorded messages to intervals, by the observers of the robot: every format, whole or cut off."""

from __future__ import annotations

import json
import math
import re
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import polars as pl
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from rosbags.rosbag1 import Writer
from tests.robomend_batch import recordings
from tests.robomend_batch.recordings import EPOCH_NS, steady, write
from tests.robomend_batch.rover import drive, drive_in_chunks, told
from tests.robomend_batch.running import batch_run, intervals, logs

from robomend_client.literals import Atom
from robomend_client.observers import Change, Driver
from robomend_client.observers.base import SECOND
from robomend_client.observers.kinds import read_lenient, read_observers, read_topics
from robomend_client.observers.recording import Recording
from robomend_client.yaml_reader import read

PYTHON = re.compile(r"has no attribute|NoneType|iterable|object is|\(\)|: '\w+'$")
"""What a library says of itself and not of a file."""

FORMATS = ("a.bag", "a.mcap", "a.db3")


def test_faults_of_a_drive_are_found_in_every_format_and_alike(
    rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    found = {}
    for name in FORMATS:
        log = write(tmp_path / name, drive())
        assert batch_run(tmp_path / f"out-{name}", log, "--observers", observers, model=model) == 0
        found[name] = told(tmp_path / f"out-{name}")
    assert found["a.bag"] == found["a.mcap"] == found["a.db3"]
    faults = [(start, bad) for start, state, bad in found["a.bag"] if state == "faulty"]
    (silent, lidar), (turning, imu) = faults
    assert 3.0 < silent < 3.5
    assert lidar == [["lidar"], ["lidar_node"]] or lidar == [["lidar_node"]]
    assert 6.0 < turning < 7.5
    assert imu == [["imu_node"]]
    observers.write_text("topics:\n  scan: {rate_hz: 10, tolerance_hz: 2}\n")
    for name in FORMATS:  # where stamps suffice no message is read
        given = tmp_path / name, "--observers", observers
        assert batch_run(tmp_path / f"stamps-{name}", *given, model=model) == 0
        assert [start for start, state, _ in told(tmp_path / f"stamps-{name}") if state == "faulty"] == [
            silent
        ]


@pytest.mark.parametrize(
    ("more", "source"),
    [
        ("ros1: {namespace: /robot1}", "diagnostics"),
        ("ros2: {namespace: robot1/, names: {scan: /robot1/scan}}", "diagnostics"),
        ("ros1: {namespace: /robot1}", "/robot1/diagnostics"),
        ("zenoh: {namespace: /robot1}", "robot1/diagnostics:status"),
    ],
)
def test_a_robot_in_a_namespace_is_diagnosed_by_the_agents_own_file(
    more: str, source: str, rover: tuple[Path, Path], tmp_path: Path
) -> None:
    """Its diagnostics are remapped into it, and statuses are known by their type."""
    model, observers = rover
    samples = [
        (at_s, topic, 90.0 if topic == "diagnostics" and at_s > 5 else v) for at_s, topic, v in drive()
    ]
    write(tmp_path / "plain.bag", samples)
    write(tmp_path / "robot.bag", samples, namespace="/robot1")
    given = ("--observers", observers)
    assert batch_run(tmp_path / "plain", tmp_path / "plain.bag", *given, model=model) == 0
    text = observers.read_text().replace("{kind: diagnostic,", f'{{kind: diagnostic, source: "{source}",')
    observers.write_text(f"{text}\n{more}\n")
    assert batch_run(tmp_path / "robot", tmp_path / "robot.bag", *given, model=model) == 0
    assert told(tmp_path / "robot") == told(tmp_path / "plain")
    assert any("not ok(hokuyo)" in one["observations"] for one in intervals(tmp_path / "robot"))


def test_what_a_robot_said_live_is_what_the_batch_of_its_recordings_says(
    rover: tuple[Path, Path], tmp_path: Path
) -> None:
    """The agent's driver, live and with its recording on; then its recording, its literals, and a bag."""
    model, observers = rover
    top = read(observers)
    specs = (*(topic.observer for topic in read_topics(top)), *read_observers(top, tmp_path))
    samples = sorted(drive(), key=lambda sample: sample[0])
    written = Recording(tmp_path / "run.jsonl", EPOCH_NS, 1 << 20)
    made, lenient = [spec.make() for spec in specs], read_lenient(top)
    driver = Driver(made, EPOCH_NS, lenient=lenient, listeners=(written,))
    live: list[Change] = []
    for time, topic, value in samples:
        at_ns = EPOCH_NS + round(time * SECOND)
        sources: dict[str, object] = {"scan": None, "odom": None}
        if topic == "odom":
            live += driver.sample("odom", at_ns, None, at_ns)
            live += driver.sample("odom:twist.twist.angular.z", at_ns, value, at_ns)
        elif topic == "diagnostics":
            status = {"name": "hokuyo: temperature", "level": 0, "values": []}
            live += driver.sample("diagnostics", at_ns, [status], at_ns)
        elif topic in sources:
            live += driver.sample(topic, at_ns, None, at_ns)
    end_ns = EPOCH_NS + round(samples[-1][0] * SECOND)
    live += driver.advance(end_ns)
    written.close(end_ns)

    names = ["run.jsonl", *FORMATS]
    for name in names:
        log = tmp_path / name if name == "run.jsonl" else write(tmp_path / name, samples)
        assert batch_run(tmp_path / f"out-{name}", log, "--observers", observers, model=model) == 0
    said = {name: rested_on(tmp_path / f"out-{name}") for name in names}
    assert all(said[name] == said["run.jsonl"] for name in FORMATS)

    known = [change for change in live if change.value is not None]
    assert all(
        change.value is not None or change.atom.predicate in ("inc", "dec", "const") for change in live
    )
    assert Atom("ok", ("scan",)) in {change.atom for change in known}
    table = [{"time": change.time_ns, "literal": str(change.value)} for change in known]
    (tmp_path / "live.ndjson").write_text("".join(json.dumps(row) + "\n" for row in table))
    pl.DataFrame(table).write_parquet(tmp_path / "live.parquet")
    faults = [one for one in said["a.bag"] if one[1] == "faulty"]
    assert len(faults) >= 2
    for name in ("live.ndjson", "live.parquet"):
        assert batch_run(tmp_path / f"out-{name}", tmp_path / name, model=model) == 0
        assert [one for one in rested_on(tmp_path / f"out-{name}") if one[1] == "faulty"] == faults


def rested_on(out: Path) -> list[tuple[int, str, object, object]]:
    """Return the beginnings of intervals, what was told of them, and the literals that it rests on."""
    return [
        (one["start_ns"], one["state"], one["bad"], sorted(one["observations"])) for one in intervals(out)
    ]


@pytest.mark.parametrize("name", FORMATS)
def test_a_recording_that_is_cut_off_is_diagnosed_up_to_there(
    name: str, rover: tuple[Path, Path], tmp_path: Path
) -> None:
    """Cut at many places: never a crash, never a verdict that the whole one does not have before the cut."""
    model, observers = rover
    whole = write(tmp_path / name, drive()).read_bytes()
    assert batch_run(tmp_path / "whole", tmp_path / name, "--observers", observers, model=model) == 0
    expected = told(tmp_path / "whole")
    states = set()
    places = [len(whole) * part // 9 for part in range(1, 9)] + [len(whole) - 1, 20, 4096]
    for place in places:
        (tmp_path / name).write_bytes(whole[:place])
        assert (
            batch_run(tmp_path / "cut", tmp_path / name, "--observers", observers, "--overwrite", model=model)
            == 2
        )
        (log,) = logs(tmp_path / "cut")
        states.add(log["state"])
        found = told(tmp_path / "cut")
        assert found[:-1] == expected[: max(len(found) - 1, 0)]
        if log["state"] == "ended-early":
            assert log["end_ns"] <= EPOCH_NS + 8 * SECOND
    assert states == {"refused", "ended-early"}


@pytest.mark.parametrize("length", [1 << 40, (1 << 64) - 1, None])
def test_a_length_that_cannot_be_is_damage(
    length: int | None, rover: tuple[Path, Path], tmp_path: Path
) -> None:
    """Libraries read as much as a record says that it has."""
    model, observers = rover
    log = tmp_path / "a.mcap"
    with log.open("wb") as file:
        drive_in_chunks(file, drive(4.0))
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    data = bytearray(log.read_bytes())
    footer = len(data) - 37
    begin = int.from_bytes(data[footer + 9 : footer + 17], "little")  # of the first record of the summary
    if length is None:  # some bytes too many: others are taken for the length
        data[begin:begin] = bytes([1] * 7)
    else:
        data[begin + 1 : begin + 9] = length.to_bytes(8, "little")
    log.write_bytes(data)
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 0
    (told_of,) = logs(tmp_path / "out")
    assert [problem["reason"] for problem in told_of["problems"] if "summary" in problem["reason"]]
    assert told_of["end_ns"] == EPOCH_NS + round(3.95 * SECOND)  # all messages stand before it


@pytest.mark.parametrize(
    ("compression", "part"),
    [(CompressionType.ZSTD, "data"), (CompressionType.LZ4, "data"), (CompressionType.ZSTD, "index")],
)
def test_a_damaged_chunk_costs_that_chunk(
    compression: CompressionType, part: str, rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    log = tmp_path / "a.mcap"
    with log.open("wb") as file:
        drive_in_chunks(file, drive(20.0), compression=compression)
    given = ("--observers", observers)
    assert batch_run(tmp_path / "whole", log, *given, model=model) == 0
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
    data = bytearray(log.read_bytes())
    if part == "data":
        begin = chunk.chunk_start_offset + 100
    else:
        begin = chunk.chunk_start_offset + chunk.chunk_length
    data[begin : begin + 60] = bytes(60)
    log.write_bytes(data)
    code = batch_run(tmp_path / "out", log, *given, model=model)
    (told_of,) = logs(tmp_path / "out")
    before, after = told(tmp_path / "whole"), told(tmp_path / "out")
    if part == "index":  # the chunk itself has all of it
        assert (code, told_of["state"], after) == (0, "ok", before)
        assert "its index disagree" in told_of["problems"][-1]["reason"]
        return
    assert (code, told_of["state"]) == (2, "bad")
    assert f"the chunk at byte {chunk.chunk_start_offset} is damaged" in told_of["problems"][-1]["reason"]
    assert told_of["end_ns"] == EPOCH_NS + round(19.95 * SECOND)
    hole_s = (chunk.message_start_time - EPOCH_NS) / SECOND
    (unknown,) = [start for start, state, _ in after if state == "unknown" and start > 1]
    assert unknown == pytest.approx(hole_s, abs=0.1)
    assert [one for one in after if one[0] < hole_s - 0.1] == [one for one in before if one[0] < hole_s - 0.1]
    assert after[-1][1:] == before[-1][1:]


@pytest.mark.parametrize(("honest", "alone"), [(True, False), (False, False), (True, True)])
def test_a_chunk_that_unpacks_to_more_than_real_ones_do_costs_that_chunk(
    honest: bool, alone: bool, rover: tuple[Path, Path], tmp_path: Path
) -> None:
    """Whether it says how much it holds or not, it is not unpacked beyond that."""
    model, observers = rover
    log = tmp_path / "a.mcap"
    with log.open("wb") as file:
        drive_in_chunks(file, drive(8.0), index_types=IndexType.NONE, use_statistics=False)
    data = log.read_bytes()
    (length,) = struct.unpack_from("<Q", data, 9)
    at = 8 + 9 + length  # behind the header: the first chunk
    (length,) = struct.unpack_from("<Q", data, at + 1)
    packed = zstandard.compress(bytes(200 << 20))
    head = data[at + 9 : at + 25] + struct.pack("<QI", 200 << 20 if honest else 4000, 0)
    content = head + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    behind = at + 9 + length
    bomb = data[at : at + 1] + struct.pack("<Q", len(content)) + content
    end = data.index(struct.pack("<BQ", 15, 4), behind)  # where the data end
    log.write_bytes(data[:at] + bomb + data[end:] if alone else data[:behind] + bomb + data[behind:])
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 2
    (told_of,) = logs(tmp_path / "out")
    assert told_of["state"] == ("refused" if alone else "bad")
    reasons = [problem["reason"] for problem in told_of["problems"]]
    place = at if alone else behind
    assert any(f"the chunk at byte {place} is damaged" in reason for reason in reasons)
    assert alone or told_of["end_ns"] == EPOCH_NS + round(7.95 * SECOND)


@pytest.mark.parametrize("change", ["name = 5", "type = NULL", "type = 7, name = NULL"])
def test_a_db3_whose_topics_are_no_texts_is_refused_in_words(
    change: str, rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    log = write(tmp_path / "a.db3", drive(2.0))
    with closing(sqlite3.connect(log)) as base, base:
        (made,) = base.execute("SELECT sql FROM sqlite_master WHERE name = 'topics'").fetchone()
        base.execute("PRAGMA writable_schema = 1")
        plain = (
            made.replace(" NOT NULL", "").replace("name TEXT", "name ANY").replace("type TEXT", "type ANY")
        )
        base.execute("UPDATE sqlite_master SET sql = ? WHERE name = 'topics'", (plain,))
    with closing(sqlite3.connect(log)) as base, base:
        base.execute(f"UPDATE topics SET {change}")
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 2
    (told_of,) = logs(tmp_path / "out")
    assert told_of["state"] in ("refused", "bad")
    for one in told_of["problems"]:
        assert not PYTHON.search(one["reason"]), one


def test_time_by_the_header_is_the_time_of_the_header(rover: tuple[Path, Path], tmp_path: Path) -> None:
    model, observers = rover
    for name in FORMATS:
        log = write(tmp_path / name, [s for s in drive() if s[1] != "diagnostics"], stamp_s=-100.0)
        out = tmp_path / f"out-{name}"
        assert batch_run(out, log, "--observers", observers, "--time", "header", model=model) == 0
        (silent, *_) = [start for start, state, _ in told(out) if state == "faulty"]
        assert -97.0 < silent < -96.5


def test_a_topic_that_is_not_there_is_told_once_and_unknown(rover: tuple[Path, Path], tmp_path: Path) -> None:
    model, observers = rover
    log = write(tmp_path / "a.bag", steady("odom", 20, 3.0))
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 0
    (record,) = logs(tmp_path / "out")
    reasons = [problem["reason"] for problem in record["problems"]]
    assert reasons == [
        "not recorded: what rests on scan is unknown",
        "not recorded: what rests on diagnostics is unknown",
    ]
    assert {state for _, state, _ in told(tmp_path / "out")} == {"unknown", "healthy"}


def test_a_topic_that_is_recorded_and_silent_is_silent(rover: tuple[Path, Path], tmp_path: Path) -> None:
    model, observers = rover
    log = write(tmp_path / "a.bag", steady("odom", 20, 4.0), silent=["scan"])
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 0
    (fault,) = [start for start, state, _ in told(tmp_path / "out") if state == "faulty"]
    assert fault == pytest.approx(2.0, abs=0.02)  # `topics:` waits so long for a first message


def test_a_topic_that_changes_its_type_is_heard_on_and_its_lost_field_is_told(
    rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    store = recordings.ROS1
    with Writer(tmp_path / "a.bag") as writer:
        was, is_ = (
            writer.add_connection("/odom", kind, typestore=store)
            for kind in ("nav_msgs/msg/Odometry", "std_msgs/msg/Float64")
        )
        for time, topic, value in steady("odom", 20, 8.0):
            at_ns = EPOCH_NS + round(time * SECOND)
            of, topic = (was, "odom") if time < 4 else (is_, "temperature")
            data = store.serialize_ros1(recordings.message(store, topic, value, at_ns, "base"), of.msgtype)
            writer.write(of, at_ns, data)
    assert batch_run(tmp_path / "out", tmp_path / "a.bag", "--observers", observers, model=model) == 2
    (record,) = logs(tmp_path / "out")
    reasons = [problem["reason"] for problem in record["problems"] if problem["place"].endswith(": odom")]
    assert "recorded with several types: nav_msgs/msg/Odometry, std_msgs/msg/Float64" in reasons
    (lost,) = [reason for reason in reasons if "std_msgs/msg/Float64 cannot be used" in reason]
    assert "odom:twist.twist.angular.z" in lost
    assert (record["state"], record["intervals"].get("faulty")) == ("bad", None)
    assert intervals(tmp_path / "out")[-1]["state"] == "healthy"  # its rate goes on


def test_a_number_that_becomes_text_is_told_in_words_and_unknown_from_then_on(tmp_path: Path) -> None:
    model, observers = tmp_path / "m.yaml", tmp_path / "o.yaml"
    model.write_text(
        "robomend: 1\nname: r\nnodes: {tank: {publishes: {level: []}}}\nproperties: {level_value: {}}\n"
        "rules: [not ab(tank) -> ok(level_value)]\n"
    )
    observers.write_text(
        'observers:\n  "ok(level_value)": {kind: property, source: "level:data", high: 5, low: 1}\n'
    )
    store, types = recordings.ROS1, recordings.ROS1.types
    with Writer(tmp_path / "a.bag") as writer:
        for number in range(80):
            name = "std_msgs/msg/Float64" if number < 40 else "std_msgs/msg/String"
            if number in (0, 40):
                of = writer.add_connection("/level", name, typestore=store)
            said: float | str = 2.0 if number < 40 else "two\nand a half"
            data = store.serialize_ros1(types[name](data=said), name)
            writer.write(of, EPOCH_NS + number * SECOND // 10, data)
    assert batch_run(tmp_path / "out", tmp_path / "a.bag", "--observers", observers, model=model) == 2
    (record,) = logs(tmp_path / "out")
    assert record["state"] == "bad"
    where = f"{tmp_path / 'a.bag'}: level:data"
    (lost,) = [problem["reason"] for problem in record["problems"] if problem["place"] == where]
    assert lost == "what level:data says cannot be read: a number is needed, not 'two\\nand a half'"
    assert not [problem for problem in record["problems"] if ".py" in problem["place"] + problem["reason"]]
    assert [(state, start) for start, state, _ in told(tmp_path / "out")][-2:] == [
        ("healthy", 0.0),
        ("unknown", 4.0),
    ]


def test_no_numbers_are_left_out_and_counted(rover: tuple[Path, Path], tmp_path: Path) -> None:
    model, observers = rover
    odom = [(time, "odom", math.nan if 1 < time < 2 else 0.0) for time, _, _ in steady("odom", 20, 3.0)]
    assert (
        batch_run(tmp_path / "out", write(tmp_path / "a.db3", odom), "--observers", observers, model=model)
        == 0
    )
    (record,) = logs(tmp_path / "out")
    (nan,) = [problem for problem in record["problems"] if "NaN" in problem["reason"]]
    assert nan["count"] == 19


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("topics: {scn: {rate_hz: 10}}", "did you mean scan"),
        ("topics: {scan: {rate_hertz: 10}}", "rate_hz"),
        ("observers: {a: {kind: generl}}", "did you mean"),
        ("lenient: []", "names no observers"),
        ("[", ""),
    ],
)
def test_observers_that_cannot_be_are_refused_before_any_log_is_read(
    text: str, said: str, rover: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, observers = rover
    observers.write_text(text)
    log = write(tmp_path / "a.bag", steady("scan", 10, 1.0))
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 2
    error = capsys.readouterr().err
    assert str(observers) in error
    assert said in error
    assert not (tmp_path / "out").exists()


def test_the_observers_alone_will_do_without_the_word_above_them(
    rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    observers.write_text("scan: {kind: general, rate_hz: 10, tolerance_hz: 2}\n")
    log = write(tmp_path / "a.bag", drive())
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 0
    assert len([1 for _, state, _ in told(tmp_path / "out") if state == "faulty"]) == 1


def test_a_recording_needs_observers(rover: tuple[Path, Path], tmp_path: Path) -> None:
    model, _ = rover
    assert batch_run(tmp_path / "out", write(tmp_path / "a.bag", steady("scan", 10, 1.0)), model=model) == 2
    assert "needs --observers" in logs(tmp_path / "out")[0]["problems"][0]["reason"]
