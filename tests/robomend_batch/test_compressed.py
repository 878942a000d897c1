"""Logs that are compressed as a whole say what they say plain; bombs and damage are told with their place."""

from __future__ import annotations

import bz2
import gzip
import random
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.robomend_batch.recordings import steady, write
from tests.robomend_batch.running import batch_run, intervals, logs, ndjson
from tests.robomend_batch.test_damage import checked_zstd

from robomend_batch.learn.gathering import gather
from robomend_batch.logs import compressed
from robomend_batch.logs.mcap_chunk import zstd

OBSERVERS = """
topics: {scan: {rate_hz: 10, tolerance_hz: 2}}
"""
MODEL = "robomend: 1\nname: rover\nnodes: {lidar_node: {publishes: {scan: []}}}\n"

DRIVE = [sample for sample in steady("scan", 10, 8) if not 3 <= sample[0] < 5]


def _long(text: bytes) -> bytes:
    """Return it as several streams one behind the other, as programs do that append or work in parallel."""
    half = len(text) // 2
    return gzip.compress(text[:half]) + gzip.compress(text[half:]) + bytes(512)


COMPRESSIONS: dict[str, Callable[[bytes], bytes]] = {
    ".zstd": zstd.compress,
    ".zst": lambda text: checked_zstd(text[:5000]) + zstd.compress(text[5000:]),
    ".checked.zst": lambda text: checked_zstd(text[:5000]) + checked_zstd(text[5000:]),
    ".gz": _long,
    ".bz2": bz2.compress,
}


def _asked(tmp_path: Path) -> tuple[Path, list[str]]:
    model, observers = tmp_path / "rover.yaml", tmp_path / "agent.yaml"
    model.write_text(MODEL)
    observers.write_text(OBSERVERS)
    return model, ["--observers", str(observers)]


@pytest.mark.parametrize("ending", COMPRESSIONS)
@pytest.mark.parametrize("name", ["drive.bag", "drive.mcap", "drive.db3", "drive.ndjson"])
def test_a_compressed_log_says_what_it_says_plain(name: str, ending: str, tmp_path: Path) -> None:
    model, asked = _asked(tmp_path)
    log = tmp_path / name
    if name.endswith(".ndjson"):
        ndjson(log, *((time, "ok(scan)" if time < 3 else "not ok(scan)") for time, _, _ in DRIVE))
    else:
        write(log, DRIVE)
    assert batch_run(tmp_path / "plain", log, *asked, model=model) == 0
    packed = tmp_path / (name + ending)
    packed.write_bytes(COMPRESSIONS[ending](log.read_bytes()))
    assert batch_run(tmp_path / "packed", packed, *asked, model=model) == 0

    (plain,), (told,) = logs(tmp_path / "plain"), logs(tmp_path / "packed")
    unchecked = ending in {".zstd", ".zst"} and not name.endswith(".ndjson")  # nor is what is in it
    assert (told["log"], told["kind"]) == (str(packed), plain["kind"])
    assert told["state"] == ("unchecked" if unchecked else "ok")
    said = ["neither its compression nor what it holds has a checksum: damage may not show"]
    assert [one["reason"] for one in told["problems"]] == said * unchecked
    assert any(one["state"] == "faulty" for one in intervals(tmp_path / "plain"))
    one_name = [{**one, "log": ""} for one in intervals(tmp_path / "packed")]
    assert one_name == [{**one, "log": ""} for one in intervals(tmp_path / "plain")]
    assert {file.suffix for file in (tmp_path / "packed" / "results").iterdir()} == {".parquet"}


def test_a_folder_of_rosbag2_is_read_where_its_files_are_compressed(tmp_path: Path) -> None:
    """The recorder packs each file that is full and says so in metadata.yaml; players unpack it beside."""
    model, asked = _asked(tmp_path)
    folder = tmp_path / "drive"
    folder.mkdir()
    plain = write(folder / "drive_0.db3", DRIVE)
    packed = folder / "drive_0.db3.zstd"
    packed.write_bytes(zstd.compress(plain.read_bytes()))
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  compression_format: zstd\n  compression_mode: FILE\n"
        "  relative_file_paths: [drive_0.db3.zstd]\n  topics_with_message_count:\n"
        "    - topic_metadata:\n        name: /scan\n"
    )
    assert batch_run(tmp_path / "both", folder, *asked, model=model) == 0
    assert [one["log"] for one in logs(tmp_path / "both")] == [str(plain)]
    plain.unlink()
    assert batch_run(tmp_path / "packed", folder, *asked, model=model) == 0
    assert [(one["log"], one["state"]) for one in logs(tmp_path / "packed")] == [(str(packed), "unchecked")]


def test_the_topics_of_a_compressed_file_are_held_against_the_metadata_beside_it(tmp_path: Path) -> None:
    model, asked = _asked(tmp_path)
    plain = write(tmp_path / "drive_0.db3", DRIVE)
    with sqlite3.connect(plain) as base:  # as before Iron, which had them beside only
        base.execute("DROP TABLE IF EXISTS metadata")
    base.close()
    packed = tmp_path / "drive_0.db3.zstd"
    packed.write_bytes(zstd.compress(plain.read_bytes()))
    plain.unlink()
    (tmp_path / "metadata.yaml").write_text("files: [drive_0.db3.zstd]\n    name: /scam\n")
    assert batch_run(tmp_path / "out", packed, *asked, model=model) == 2
    (told,) = logs(tmp_path / "out")
    assert told["state"] == "bad"
    assert "its metadata do not know the topic /scan" in told["problems"][0]["reason"]


@pytest.mark.parametrize("ending", COMPRESSIONS)
def test_damage_costs_what_follows_it(ending: str, tmp_path: Path) -> None:
    """Bytes that are long and do not shrink: blocks of a compressor are up to 900 kB."""
    model, asked = _asked(tmp_path)
    chance = random.Random(ending)
    samples = [(at, "imu", chance.random()) for at, _, _ in steady("imu", 2000, 8)]
    samples += DRIVE
    log = write(tmp_path / "drive.bag", samples, chunk_bytes=20_000)
    whole = COMPRESSIONS[ending](log.read_bytes())
    assert len(whole) > 200_000
    packed = tmp_path / f"drive.bag{ending}"
    for damaged in (whole[: len(whole) * 9 // 10], _turned(whole, len(whole) * 9 // 10)):
        packed.write_bytes(damaged)
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        assert batch_run(tmp_path / "out", packed, *asked, model=model) == 2
        (told,) = logs(tmp_path / "out")
        assert told["state"] == "ended-early"
        reasons = [one["reason"] for one in told["problems"]]
        assert any("ended early" in reason for reason in reasons), reasons
        assert all(one["place"].startswith(str(packed)) for one in told["problems"])
        assert told["end_ns"] - told["start_ns"] > 2e9
        found = [one for one in intervals(tmp_path / "out") if one["state"] == "healthy"]
        assert found, "what came before the damage is diagnosed"


def _turned(data: bytes, at: int) -> bytes:
    return data[:at] + bytes(byte ^ 0x5A for byte in data[at : at + 64]) + data[at + 64 :]


def test_what_unpacks_to_nothing_is_refused_with_its_place(tmp_path: Path) -> None:
    model, asked = _asked(tmp_path)
    log = tmp_path / "drive.bag.gz"
    log.write_bytes(b"\x1f\x8b\x08" + bytes(20))
    assert batch_run(tmp_path / "out", log, *asked, model=model) == 2
    (told,) = logs(tmp_path / "out")
    assert told["state"] == "refused"
    assert "its compression is damaged" in told["problems"][0]["reason"]


@pytest.mark.parametrize("ending", COMPRESSIONS)
def test_a_bomb_is_refused_with_its_place_and_leaves_nothing(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compressed, "ALWAYS", 4 << 20)
    model, asked = _asked(tmp_path)
    bomb = tmp_path / f"bomb.mcap{ending}"
    bomb.write_bytes(COMPRESSIONS[ending](b"\x89MCAP0\r\n" + bytes(64 << 20)))
    good = write(tmp_path / "drive.mcap", DRIVE)
    assert batch_run(tmp_path / "out", bomb, good, *asked, model=model) == 2
    refused, told = logs(tmp_path / "out")
    assert (refused["state"], told["state"]) == ("refused", "ok")
    (problem,) = refused["problems"]
    assert problem["place"] == str(bomb)
    assert "it unpacks to more than" in problem["reason"]
    assert "at byte" in problem["reason"]
    assert {file.suffix for file in (tmp_path / "out" / "results").iterdir()} == {".parquet"}


def test_a_log_that_leaves_no_room_on_the_disk_is_refused_and_the_others_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Usage:
        free = 1000

    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage)
    model, asked = _asked(tmp_path)
    good = write(tmp_path / "good.mcap", DRIVE)
    large = tmp_path / "large.mcap.gz"
    large.write_bytes(gzip.compress(good.read_bytes()))
    assert batch_run(tmp_path / "out", large, good, *asked, model=model) == 2
    assert {one["log"]: one["state"] for one in logs(tmp_path / "out")} == {
        str(good): "ok",
        str(large): "refused",
    }


def test_a_compressed_log_is_learned_from(tmp_path: Path) -> None:
    log = write(tmp_path / "drive.bag", steady("scan", 10, 8))
    packed = tmp_path / "drive.bag.gz"
    packed.write_bytes(gzip.compress(log.read_bytes()))
    found = gather([str(packed)])
    assert found.topics["scan"].count == 80
    assert found.names == [str(packed)]
