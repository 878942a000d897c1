"""Logs that never lie: a damaged log says what it said before, or that something is wrong.

Excepted is what nobody can see: a value of a message that became another one. So after one damaged byte the
value that is watched may be wrong for as long as one message counts, and after more damage it is not judged;
when topics came, and what follows of it, is never wrong.
"""

from __future__ import annotations

import gzip
import json
import math
import os
import random
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType
from tests.robomend_batch.recordings import Sample, steady, write
from tests.robomend_batch.rover import drive_in_chunks

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

COPIES = int(os.environ.get("ROBOMEND_COPIES", "7"))
"""Of each format, damaged in each way by turns; as often by times alone."""

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


def _rosbag(compression: str = "") -> Callable[[Path], object]:
    """As rosbags writes a .bag or .db3."""
    return lambda file: write(file, small_drive(), compression=compression, chunk_bytes=1500)


def _mcap(compression: CompressionType, **options: Any) -> Callable[[Path], object]:
    def written(file: Path) -> None:
        with file.open("wb") as opened:
            how: dict[str, Any] = {"chunk_size": 1500, "compression": compression, **options}
            drive_in_chunks(opened, small_drive(), topics=("scan", "temperature"), **how)

    return written


def checked_zstd(data: bytes) -> bytes:
    """As the command `zstd` packs a file."""
    return zstd.compress(data, options={zstd.CompressionParameter.checksum_flag: 1})


def _compressed(write: Callable[[Path], object], pack: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    """As a whole; zstd writes no checksum by itself."""

    def packed(file: Path) -> None:
        write(plain := file.with_name(f"unpacked{Path(file.stem).suffix}"))
        plain.rename(file)
        file.write_bytes(pack(file.read_bytes()))

    return packed


NO_INDEX: dict[str, Any] = {"index_types": IndexType.NONE}
NO_CHECKSUM: dict[str, Any] = {"enable_crcs": False}

FORMATS: dict[str, Callable[[Path], object]] = {
    "none.bag": _rosbag(),
    "bz2.bag": _rosbag("BZ2"),
    "lz4.bag": _rosbag("LZ4"),
    "none.mcap": _mcap(CompressionType.NONE),
    "zstd.mcap": _mcap(CompressionType.ZSTD),
    "lz4.mcap": _mcap(CompressionType.LZ4),
    "none-unchecked.mcap": _mcap(CompressionType.NONE, **NO_CHECKSUM),
    "zstd-unchecked.mcap": _mcap(CompressionType.ZSTD, **NO_CHECKSUM),
    "none-stream.mcap": _mcap(CompressionType.NONE, **NO_INDEX),
    "zstd-stream.mcap": _mcap(CompressionType.ZSTD, **NO_INDEX),
    "lz4-stream.mcap": _mcap(CompressionType.LZ4, **NO_INDEX),
    "messages-stream.mcap": _mcap(CompressionType.NONE, use_chunking=False),
    "plain.db3": _rosbag(),
    "packed.db3": _rosbag("ZSTD"),
    "none.bag.gz": _compressed(_rosbag(), gzip.compress),
    "none.mcap.zstd": _compressed(_mcap(CompressionType.NONE), zstd.compress),
    "plain.db3.zstd": _compressed(_rosbag(), zstd.compress),
    "none.bag.zst": _compressed(_rosbag(), checked_zstd),
    "plain.db3.zst": _compressed(_rosbag(), checked_zstd),
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


def _lie(
    record: dict[str, Any],
    lines: list[dict[str, Any]],
    truth: list[dict[str, Any]],
    value_s: float = ONE_VALUE_S,
) -> str:
    """Return what is wrong and called ok; "": nothing. A value may be wrong for so long."""
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
    if wrong["lidar_node"] > 2 * SLACK_S + step_s or wrong["heater_node"] > value_s:
        return f"wrong for {wrong} s"
    return ""


def _at(lines: list[dict[str, Any]], at_ns: int) -> dict[str, Any] | None:
    return next((line for line in lines if line["start_ns"] <= at_ns < line["end_ns"]), None)


def test_every_format_says_the_same(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "out")
    found = []
    for name, written in FORMATS.items():
        written(tmp_path / name)
        record, lines = bench.told(tmp_path / name)
        assert record["state"] == expected_state(name), (name, record["problems"])
        found.append([(line["start_ns"], line["end_ns"], line["state"], line["bad"]) for line in lines])
    assert all(one == found[0] for one in found)


def _flipped(data: bytearray, chance: random.Random) -> None:
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)


def _bits(data: bytearray, chance: random.Random) -> None:
    for _ in range(chance.choice((1, 8, 64))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)


def _truncated(data: bytearray, chance: random.Random) -> None:
    del data[chance.randrange(len(data) // 4, len(data)) :]


def _zeroed(data: bytearray, chance: random.Random) -> None:
    size = chance.choice((16, 512, 4096, 65536))
    at = chance.randrange(max(1, len(data) - size))
    end = min(len(data), at + size)
    data[at:end] = bytes(end - at)


def _swapped(data: bytearray, chance: random.Random) -> None:
    """As a disk does that writes blocks where others belong."""
    size = chance.choice((512, 4096))
    first, second = (chance.randrange(max(1, len(data) // size)) * size for _ in range(2))
    data[first : first + size], data[second : second + size] = (
        data[second : second + size],
        data[first : first + size],
    )


def _lost(data: bytearray, chance: random.Random) -> None:
    size = chance.choice((512, 4096))
    at = chance.randrange(max(1, len(data) // size)) * size
    del data[at : at + size]


def _doubled(data: bytearray, chance: random.Random) -> None:
    size = chance.choice((512, 4096))
    at = chance.randrange(max(1, len(data) // size)) * size
    data[at:at] = data[at : at + size]


def _chunks_swapped(data: bytearray, chance: random.Random) -> None:
    """Whole records change their places, as nothing but a wrong tool would do it; else blocks do."""
    places = [*_chunks(bytes(data))]
    if len(places) < 2:
        _swapped(data, chance)
        return
    (first, first_end), (second, second_end) = sorted(chance.sample(places, 2))
    data[:] = (
        data[:first]
        + data[second:second_end]
        + data[first_end:second]
        + data[first:first_end]
        + data[second_end:]
    )


def _chunks(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield where the chunks of a .bag or .mcap begin and end."""
    if data.startswith(b"\x89MCAP0\r\n"):
        at = 8
        while at + 9 < len(data) - 8:
            operation, length = struct.unpack_from("<BQ", data, at)
            if operation == 6:
                yield at, at + 9 + length
            at += 9 + length
    elif data.startswith(b"#ROSBAG"):
        at = 13
        while at < len(data):
            (head,) = struct.unpack_from("<I", data, at)
            (size,) = struct.unpack_from("<I", data, at + 4 + head)
            if b"op=\x05" in data[at : at + 4 + head]:
                yield at, at + 8 + head + size
            at += 8 + head + size


DAMAGES = (_bits, _truncated, _zeroed, _swapped, _lost, _doubled, _chunks_swapped)


@pytest.mark.parametrize("by_values", [True, False], ids=["values", "times"])
@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_log_gives_no_wrong_verdict_that_is_called_ok(
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
    ways = [_flipped] * (FLIPS // (2 * len(FORMATS))) + [DAMAGES[n % len(DAMAGES)] for n in range(COPIES)]
    if "stream" in name:  # where time goes back a recording has segments, and no index says otherwise
        ways = [damage for damage in ways if damage is not _chunks_swapped]
    lies = []
    for number, damage in enumerate(ways):
        data = bytearray(whole)
        damage(data, chance)
        log.write_bytes(data)
        record, lines = bench.told(log)
        value_s = ONE_VALUE_S if damage is _flipped else math.inf
        if data != whole and (lie := _lie(record, lines, truth, value_s)):
            lies.append(f"copy {number}, {damage.__name__}: {lie}, {record['problems']}")
    assert not lies, "\n".join(lies)


def test_an_index_of_which_nothing_can_be_read_is_said_and_its_rows_are_taken_at_their_word(
    tmp_path: Path,
) -> None:
    log = tmp_path / "plain.db3"
    FORMATS[log.name](log)
    bench = Bench(tmp_path / "out", observers=OBSERVERS.split("observers")[0])
    _, truth = bench.told(log)
    with closing(sqlite3.connect(log)) as base:
        (page_bytes,) = base.execute("PRAGMA page_size").fetchone()
        (page,) = base.execute("SELECT rootpage FROM sqlite_master WHERE name = 'timestamp_idx'").fetchone()
    data = bytearray(log.read_bytes())
    end = page * page_bytes - 23  # among its first entries, which are at the end of its page
    data[end - 16 : end] = bytes(16)
    log.write_bytes(data)
    record, lines = bench.told(log)
    assert record["state"] != "ok", record
    assert ["its rows and its index disagree" in one["reason"] for one in record["problems"]] == [True]
    assert [line["bad"] for line in lines] == [line["bad"] for line in truth]
