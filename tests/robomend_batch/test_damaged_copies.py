"""Damaged copies of a public log: each says what the whole one says, or that something is wrong.

ROBOMEND_BAGS may name a folder of further bags; a copy of each format is made of every one of them.
"""

from __future__ import annotations

import bisect
import gzip
import os
import random
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from tests.robomend_batch.test_damage import Bench, checked_zstd, expected_state

from robomend_batch.logs.bag import open_bag
from robomend_batch.logs.recorded import Channel
from robomend_client.observers.base import SECOND

DATA = Path(__file__).with_name("data")
BAGS = sorted([*DATA.glob("*.bag"), *Path(os.environ.get("ROBOMEND_BAGS", "/nowhere")).glob("*.bag")])
COPIES = int(os.environ.get("ROBOMEND_COPIES", "14"))
"""Of each log and format; six formats make 84 of one log."""

CHUNK_BYTES = 20_000

SLACK_S = 0.4
"""As for single bytes."""


@pytest.fixture(params=BAGS, ids=lambda bag: bag.stem)
def bag(request: pytest.FixtureRequest) -> Path:
    return Path(request.param)


def _messages(bag: Path) -> tuple[list[Channel], list[tuple[int, int, bytes]]]:
    recording = open_bag(bag)
    found = [
        (time_ns, number, data or b"")
        for time_ns, number, data in recording.messages({one.number: True for one in recording.channels})
    ]
    recording.close()
    return recording.channels, found


def _as_bag(compression: str) -> Callable[[Path, Path], None]:
    def write(bag: Path, file: Path) -> None:
        channels, messages = _messages(bag)
        writer = Writer1(file)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression])
        writer.chunk_threshold = CHUNK_BYTES
        with Reader1(bag) as reader, writer:
            sums = {one.id: one.digest for one in reader.connections}
            of = {
                one.number: writer.add_connection(
                    f"/{one.topic}",
                    one.type_name,
                    msgdef=one.definition,
                    md5sum=sums[one.number],
                    callerid=one.publisher or None,
                )
                for one in channels
            }
            for time_ns, number, data in messages:
                writer.write(of[number], time_ns, data)

    return write


def _as_mcap(compression: CompressionType) -> Callable[[Path, Path], None]:
    def write(bag: Path, file: Path) -> None:
        channels, messages = _messages(bag)
        with file.open("wb") as opened:
            writer = McapWriter(opened, chunk_size=CHUNK_BYTES, compression=compression)
            writer.start(profile="ros1", library="test")
            of = {}
            for one in channels:
                schema = writer.register_schema(one.type_name, "ros1msg", one.definition.encode())
                of[one.number] = writer.register_channel(f"/{one.topic}", "ros1", schema)
            for time_ns, number, data in messages:
                writer.add_message(of[number], time_ns, data, time_ns)
            writer.finish()  # type: ignore[no-untyped-call]  # the library's

    return write


def _as_db3(*, compressed: bool) -> Callable[[Path, Path], None]:
    def write(bag: Path, file: Path) -> None:
        channels, messages = _messages(bag)
        folder = file.with_name(file.name + ".folder")
        writer = Writer2(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
        if compressed:
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        with writer:
            of = {}
            for one in channels:
                if one.topic not in of:  # its publishers are one topic there
                    of[one.topic] = writer.add_connection(
                        f"/{one.topic}",
                        one.type_name,
                        msgdef=one.definition,
                        rihs01="RIHS01_" + "0" * 64,
                        serialization_format="ros1",
                    )
            topics = {one.number: one.topic for one in channels}
            for time_ns, number, data in messages:
                writer.write(of[topics[number]], time_ns, data)
        (written,) = folder.glob("*.db3")
        written.rename(file)

    return write


def _packed(
    write: Callable[[Path, Path], None], pack: Callable[[bytes], bytes]
) -> Callable[[Path, Path], None]:
    def packed(bag: Path, file: Path) -> None:
        write(bag, file)
        file.write_bytes(pack(file.read_bytes()))

    return packed


FORMATS: dict[str, Callable[[Path, Path], None]] = {
    "none.bag": _as_bag(""),
    "bz2.bag": _as_bag("BZ2"),
    "zstd.mcap": _as_mcap(CompressionType.ZSTD),
    "plain.db3": _as_db3(compressed=False),
    "none.bag.gz": _packed(_as_bag(""), gzip.compress),
    "plain.db3.zst": _packed(_as_db3(compressed=False), checked_zstd),
}


# --- damage


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
    first, second = (chance.randrange(len(data) // size) * size for _ in range(2))
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


# --- what is said of it


def _watched(bag: Path) -> tuple[str, str]:
    """Return a model and observers for the topics of a bag: a node and a rate each."""
    channels, messages = _messages(bag)
    topics = {one.number: one.topic for one in channels}
    span_s = (messages[-1][0] - messages[0][0]) / SECOND
    counts = Counter(topics[number] for _, number, _ in messages)
    rates = {topic: count / span_s for topic, count in sorted(counts.items()) if count >= 5}
    nodes = ", ".join(f'"{_node(topic)}": {{publishes: {{"{topic}": []}}}}' for topic in rates)
    topic, field = next((topic, field) for topic, field in NUMBERS if topic in rates)
    model = f"robomend: 1\nname: public\nnodes: {{{nodes}}}\n"
    model += f'values: {{number: {{topic: "{topic}", field: {field}}}}}\n'
    observers = "topics:\n"
    for name, rate in rates.items():
        numbers = f"rate_hz: {rate:.4g}, tolerance_hz: {rate / 2:.4g}, silence_s: {max(1, 4 / rate):.3g}"
        observers += f'  "{name}": {{{numbers}}}\n'
    watched = f'{{kind: qualitative, source: "{topic}:{field}", slope: 0.1}}'
    return model, f"{observers}observers:\n  number: {watched}\n"


NUMBERS = (("turtle1/pose", "x"), ("base_pose_ground_truth", "pose.pose.position.x"))
"""A value, so that the messages are read as well; it is not judged, as values may be damaged unseen."""


def _node(topic: str) -> str:
    return topic.replace("/", "_") + "_node"


def _lie(
    record: dict[str, Any], lines: list[dict[str, Any]], truth: list[dict[str, Any]], components: list[str]
) -> str:
    """Return what is wrong and called ok; "": nothing."""
    if record["state"] != "ok":
        return ""
    begin, end = truth[0]["start_ns"], truth[-1]["end_ns"]
    for at, name, there in ((record["start_ns"], "begins", begin), (record["end_ns"], "ends", end)):
        if abs(at - there) > SLACK_S * SECOND:
            return f"it {name} {(at - there) / SECOND:.3g} s off"
    wrong: Counter[str] = Counter()
    edges = sorted({edge for line in (*lines, *truth) for edge in (line["start_ns"], line["end_ns"])})
    for at, until in pairwise(edges):
        found, right = _at(lines, at), _at(truth, at)
        if found is None or found["state"] == "unknown" or right is None:
            continue
        for component in components:
            bad = [any(component in one for one in row["bad"] or ()) for row in (found, right)]
            wrong[component] += (until - at) * (bad[0] != bad[1])
    spans = {name: span / SECOND for name, span in wrong.items() if span > 2 * SLACK_S * SECOND}
    return f"wrong for {spans}" if spans else ""


def _at(lines: list[dict[str, Any]], at_ns: int) -> dict[str, Any] | None:
    place = bisect.bisect_right([line["start_ns"] for line in lines], at_ns) - 1
    return lines[place] if place >= 0 and at_ns < lines[place]["end_ns"] else None


@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_copy_says_what_the_whole_log_says_or_that_something_is_wrong(
    name: str, bag: Path, tmp_path: Path
) -> None:
    log = tmp_path / name
    FORMATS[name](bag, log)
    model, observers = _watched(bag)
    benches = [
        Bench(tmp_path / "values", model, observers),
        Bench(tmp_path / "times", model, observers.partition("observers:")[0]),
    ]
    truths = []
    for bench in benches:
        record, truth = bench.told(log)
        assert record["state"] == expected_state(name), record["problems"]
        truths.append(truth)
    components = [_node(one.topic) for one in _messages(bag)[0]]
    whole = log.read_bytes()
    chance = random.Random(f"{bag.stem} {name}")
    lies, states = [], Counter[str]()
    for copy in range(COPIES):
        damage = DAMAGES[copy % len(DAMAGES)]
        data = bytearray(whole)
        damage(data, chance)
        log.write_bytes(data)
        which = copy // len(DAMAGES) % 2
        record, lines = benches[which].told(log)
        states[record["state"]] += 1
        if data != whole and (lie := _lie(record, lines, truths[which], components)):
            lies.append(f"copy {copy}, {damage.__name__}: {lie}, {record['problems']}")
    assert not lies, "\n".join([*lies, str(states)])
