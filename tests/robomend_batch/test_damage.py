"""Logs that never lie: with one damaged byte a log says what it said before, or that something is wrong.

Excepted is what nobody can see: a value of a message that became another one. So the value that is watched
may be wrong for as long as one message counts; when topics came, and what follows of it, may not.
"""

from __future__ import annotations

import gzip
import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from tests.robomend_batch.recordings import EPOCH_NS, KINDS, ROS1, ROS2, Sample, message, steady

from robomend.diagnosis.result import Options
from robomend.model.loading import load_model
from robomend_batch.logs.mcap_chunk import zstd
from robomend_batch.one_log import Diagnoser, Setup
from robomend_client.observers.base import SECOND

MODEL = """
robomend: 1
name: rover
nodes: {lidar_node: {publishes: {scan: []}}, heater_node: {publishes: {temperature: []}}}
values: {heat: {topic: temperature, field: data}}
rules: ["not ab(heater_node) -> not inc(heat)"]
"""

OBSERVERS = """
topics:
  scan: {rate_hz: 10, tolerance_hz: 2}
  temperature: {rate_hz: 20, tolerance_hz: 3}
observers:
  heat: {kind: qualitative, source: "temperature:data", slope: 0.1}
"""

FLIPS = int(os.environ.get("ROBOMEND_FLIPS", "336"))
"""Over all formats together; 5,000 take some minutes."""

SLACK_S = 0.4
"""A stamp that stays between its neighbours may move the beginning of a fault by so much."""

ONE_VALUE_S = 2.0
"""So long a value that is far off is in the window of an observer, twice."""

END_S = 8.0


def small_drive() -> list[Sample]:
    """A scan that is silent from 3 to 5 s, a temperature that rises from 6 s on."""
    scan = [sample for sample in steady("scan", 10, END_S) if not 3 <= sample[0] < 5]
    heat = [
        (time, "temperature", 20.0 + max(0.0, time - 6.0)) for time, _, _ in steady("temperature", 20, END_S)
    ]
    return sorted([*scan, *heat], key=lambda sample: sample[0])


def _bag(compression: str) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        writer = Writer1(file)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression])
        writer.chunk_threshold = 1500
        with writer:
            of = {
                topic: writer.add_connection(f"/{topic}", KINDS[topic], typestore=ROS1)
                for topic in ("scan", "temperature")
            }
            for time, topic, value in small_drive():
                at_ns = EPOCH_NS + round(time * SECOND)
                made = ROS1.serialize_ros1(message(ROS1, topic, value, at_ns, "base"), KINDS[topic])
                writer.write(of[topic], at_ns, made)

    return write


def _mcap(compression: CompressionType, **options: Any) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        with file.open("wb") as opened:
            writer = McapWriter(opened, chunk_size=1500, compression=compression, **options)
            writer.start(profile="ros2", library="test")
            channels = {}
            for topic in ("scan", "temperature"):
                text, _ = ROS2.generate_msgdef(KINDS[topic], ros_version=2)
                schema = writer.register_schema(KINDS[topic], "ros2msg", text.encode())
                channels[topic] = writer.register_channel(f"/{topic}", "cdr", schema)
            for number, (time, topic, value) in enumerate(small_drive()):
                at_ns = EPOCH_NS + round(time * SECOND)
                body = bytes(ROS2.serialize_cdr(message(ROS2, topic, value, at_ns, "base"), KINDS[topic]))
                writer.add_message(channels[topic], at_ns, body, at_ns, number)
            writer.finish()  # type: ignore[no-untyped-call]  # the library's

    return write


def _db3(*, compressed: bool) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        folder = file.with_name(file.name + ".folder")
        writer = Writer2(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
        if compressed:
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        with writer:
            of = {
                topic: writer.add_connection(f"/{topic}", KINDS[topic], typestore=ROS2)
                for topic in ("scan", "temperature")
            }
            for time, topic, value in small_drive():
                at_ns = EPOCH_NS + round(time * SECOND)
                made = ROS2.serialize_cdr(message(ROS2, topic, value, at_ns, "base"), KINDS[topic])
                writer.write(of[topic], at_ns, made)
        (written,) = folder.glob("*.db3")
        written.rename(file)
        shutil.rmtree(folder)

    return write


def checked_zstd(data: bytes) -> bytes:
    """As the command `zstd` packs a file."""
    return zstd.compress(data, options={zstd.CompressionParameter.checksum_flag: 1})


def _compressed(write: Callable[[Path], None], pack: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """As a whole; zstd writes no checksum by itself."""

    def packed(file: Path) -> None:
        write(file)
        file.write_bytes(pack(file.read_bytes()))

    return packed


NO_INDEX: dict[str, Any] = {"index_types": IndexType.NONE}
NO_CHECKSUM: dict[str, Any] = {"enable_crcs": False}

FORMATS: dict[str, Callable[[Path], None]] = {
    "none.bag": _bag(""),
    "bz2.bag": _bag("BZ2"),
    "lz4.bag": _bag("LZ4"),
    "none.mcap": _mcap(CompressionType.NONE),
    "zstd.mcap": _mcap(CompressionType.ZSTD),
    "lz4.mcap": _mcap(CompressionType.LZ4),
    "none-unchecked.mcap": _mcap(CompressionType.NONE, **NO_CHECKSUM),
    "zstd-unchecked.mcap": _mcap(CompressionType.ZSTD, **NO_CHECKSUM),
    "none-stream.mcap": _mcap(CompressionType.NONE, **NO_INDEX),
    "zstd-stream.mcap": _mcap(CompressionType.ZSTD, **NO_INDEX),
    "lz4-stream.mcap": _mcap(CompressionType.LZ4, **NO_INDEX),
    "messages-stream.mcap": _mcap(CompressionType.NONE, use_chunking=False),
    "plain.db3": _db3(compressed=False),
    "packed.db3": _db3(compressed=True),
    "none.bag.gz": _compressed(_bag(""), gzip.compress),
    "none.mcap.zstd": _compressed(_mcap(CompressionType.NONE), zstd.compress),
    "plain.db3.zstd": _compressed(_db3(compressed=False), zstd.compress),
    "none.bag.zst": _compressed(_bag(""), checked_zstd),
    "plain.db3.zst": _compressed(_db3(compressed=False), checked_zstd),
    "none-unchecked.mcap.zstd": _compressed(_mcap(CompressionType.NONE, **NO_CHECKSUM), zstd.compress),
    "lz4-unchecked.mcap": _mcap(CompressionType.LZ4, **NO_CHECKSUM),
    "none-unchecked-stream.mcap": _mcap(CompressionType.NONE, **NO_CHECKSUM, **NO_INDEX),
    "zstd-unchecked-stream.mcap": _mcap(CompressionType.ZSTD, **NO_CHECKSUM, **NO_INDEX),
}

UNCHECKED = {"plain.db3.zstd", "none-unchecked.mcap.zstd", "zstd-unchecked-stream.mcap"}
"""One damaged byte of these may change many that are read, and nothing shows it: they are never called ok."""


def expected_state(name: str) -> str:
    return "unchecked" if name in UNCHECKED else "ok"


class Bench:
    """Diagnoses one small log after another."""

    def __init__(self, folder: Path, model: str = MODEL, observers: str = OBSERVERS) -> None:
        (folder / "results").mkdir(parents=True)
        (folder / "rover.yaml").write_text(model)
        (folder / "agent.yaml").write_text(observers)
        self._out = folder
        setup = Setup(
            load_model(str(folder / "rover.yaml")),
            Options(conflicts=False),
            folder,
            observers=folder / "agent.yaml",
            ndjson=True,
        )
        self._diagnoser = Diagnoser(setup)

    def told(self, log: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """Return what is said of a log, and its intervals."""
        try:
            (record,) = self._diagnoser.diagnose(str(log))
            lines: list[dict[str, Any]] = []
            for part in sorted(self._out.glob("results/*.ndjson")):
                lines += map(json.loads, part.read_text().splitlines())
            return record, lines
        finally:
            for part in self._out.glob("results/*"):
                part.unlink()


def _lie(record: dict[str, Any], lines: list[dict[str, Any]], truth: list[dict[str, Any]]) -> str:
    """Return what is wrong and called ok; "": nothing."""
    if record["state"] != "ok":
        return ""
    begin, end = truth[0]["start_ns"], truth[-1]["end_ns"]
    for at, name, there in ((record["start_ns"], "begins", begin), (record["end_ns"], "ends", end)):
        if abs(at - there) > SLACK_S * SECOND:
            return f"it {name} {(at - there) / SECOND:.3g} s off"
    wrong = {"lidar_node": 0.0, "heater_node": 0.0}
    step_s = 0.05
    for number in range(round(END_S / step_s)):
        at = begin + round((number + 0.5) * step_s * SECOND)
        found, right = _at(lines, at), _at(truth, at)
        if found is None or right is None or found["state"] == "unknown" or right["state"] == "unknown":
            wrong["lidar_node"] += step_s * (found is None or found["state"] != "unknown") * (found != right)
            continue
        for component in wrong:
            bad = [any(component in one for one in row["bad"]) for row in (found, right)]
            wrong[component] += step_s * (bad[0] != bad[1])
    if wrong["lidar_node"] > 2 * SLACK_S + step_s or wrong["heater_node"] > ONE_VALUE_S:
        return f"wrong for {wrong} s"
    return ""


def _at(lines: list[dict[str, Any]], at_ns: int) -> dict[str, Any] | None:
    return next((line for line in lines if line["start_ns"] <= at_ns < line["end_ns"]), None)


def test_every_format_says_the_same(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "out")
    found = []
    for name, write in FORMATS.items():
        write(tmp_path / name)
        record, lines = bench.told(tmp_path / name)
        assert record["state"] == expected_state(name), (name, record["problems"])
        found.append([(line["start_ns"], line["end_ns"], line["state"], line["bad"]) for line in lines])
    assert all(one == found[0] for one in found)


@pytest.mark.parametrize("by_values", [True, False], ids=["values", "times"])
@pytest.mark.parametrize("name", FORMATS)
def test_one_damaged_byte_makes_no_wrong_verdict_that_is_called_ok(
    name: str, by_values: bool, tmp_path: Path
) -> None:
    log = tmp_path / name
    FORMATS[name](log)
    bench = Bench(tmp_path / "out", observers=OBSERVERS if by_values else OBSERVERS.split("observers")[0])
    record, truth = bench.told(log)
    assert record["state"] == expected_state(name), record["problems"]
    assert [line["bad"] for line in truth if line["state"] == "faulty"], truth
    whole = log.read_bytes()
    chance = random.Random(f"{name} {by_values}")
    lies = []
    for _ in range(FLIPS // (2 * len(FORMATS))):
        place, bit = chance.randrange(len(whole)), chance.randrange(8)
        log.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :])
        record, lines = bench.told(log)
        if lie := _lie(record, lines, truth):
            lies.append(f"byte {place} of {len(whole)}, bit {bit}: {lie}, {record['problems']}")
    assert not lies, "\n".join(lies)
