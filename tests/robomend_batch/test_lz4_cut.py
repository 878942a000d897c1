"""Of an LZ4 frame that is cut off anywhere, what comes before the cut is read, to the byte."""

from __future__ import annotations

import random
from itertools import pairwise
from pathlib import Path

import lz4.frame
import pytest
from rosbags.rosbag1 import Writer
from tests.robomend_batch.running import batch_run, intervals, logs

from robomend_batch.logs.lz4_cut import unpacked

WORDS = [b"odom", b"scan", b"base_link", bytes(40), b"x" * 700, *(bytes([n] * 3) for n in range(9))]


def text(seed: int, length: int) -> bytes:
    """Return what can be packed well, badly, and not at all, by turns."""
    chance = random.Random(seed)
    found = b""
    while len(found) < length:
        found += chance.choice([*WORDS, chance.randbytes(chance.randrange(1, 400))])
    return found[:length]


@pytest.mark.parametrize("linked", [True, False])
@pytest.mark.parametrize("checked", [True, False])
@pytest.mark.parametrize("sized", [True, False])
def test_it_is_what_the_whole_begins_with_wherever_it_is_cut(
    linked: bool, checked: bool, sized: bool
) -> None:
    whole = text(linked + 2 * checked, 150_000)
    packed = lz4.frame.compress(
        whole,
        block_size=lz4.frame.BLOCKSIZE_MAX64KB,
        block_linked=linked,
        block_checksum=checked,
        content_checksum=True,
        store_size=sized,
    )
    assert unpacked(packed) == whole
    cuts = sorted(random.Random(1).sample(range(30, len(packed)), 200))
    told = [unpacked(packed[:cut]) for cut in cuts]
    assert all(whole.startswith(one) for one in told)
    assert all(len(one) <= len(other) for one, other in pairwise(told))
    assert len(told[len(told) // 2]) > len(whole) // 3  # not whole blocks alone: there are three


@pytest.mark.parametrize("most", [0, 1, 1000, 70_000])
def test_no_more_is_told_than_wanted(most: int) -> None:
    packed = lz4.frame.compress(text(3, 100_000), block_size=lz4.frame.BLOCKSIZE_MAX64KB)
    assert len(unpacked(packed[:-100], most)) <= most


def test_what_is_damaged_ends_and_is_no_endless_search() -> None:
    whole = text(5, 40_000)
    packed = bytearray(lz4.frame.compress(whole, block_size=lz4.frame.BLOCKSIZE_MAX64KB))
    chance = random.Random(2)
    for _ in range(300):
        broken = packed[: chance.randrange(30, len(packed))]
        broken[chance.randrange(19, len(broken))] ^= 1 << chance.randrange(8)
        try:
            told = unpacked(bytes(broken))
        except RuntimeError:
            continue
        assert len(told) < 1 << 24


def test_a_bag_whose_only_chunk_is_cut_off_is_diagnosed_up_to_there(tmp_path: Path) -> None:
    bag = tmp_path / "whole.bag"
    writer = Writer(bag)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        of = writer.add_connection("/odom", "std_msgs/msg/String", msgdef="string data\n", md5sum="0" * 32)
        for number in range(600):  # a minute; none from the 30th second to the 40th
            if not 300 <= number < 400:
                data = text(number, 200)
                writer.write(of, 10**18 + number * 10**8, len(data).to_bytes(4, "little") + data)
    cut = tmp_path / "died.bag.active"
    cut.write_bytes(bag.read_bytes()[: bag.stat().st_size * 9 // 10])
    bag.unlink()
    model, observers, out = tmp_path / "model.yaml", tmp_path / "observers.yaml", tmp_path / "out"
    model.write_text("robomend: 1\nname: r\nnodes:\n  base: {publishes: {odom: []}}\n")
    observers.write_text("topics:\n  odom: {rate_hz: 10, tolerance_hz: 3}\n")
    assert batch_run(out, cut, "--observers", observers, model=model) == 2
    (log,) = logs(out)
    assert log["state"] == "ended-early"
    assert log["end_ns"] > 10**18 + 45 * 10**9
    assert [one["state"] for one in intervals(out) if one["state"] != "unknown"] == [
        "healthy",
        "faulty",
        "healthy",
    ]
