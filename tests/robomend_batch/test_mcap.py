"""MCAP files as they come: cut off, without an index, out of order, of types that nobody knows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from tests.robomend_batch.recordings import EPOCH_NS, KINDS, Recorder, Sample
from tests.robomend_batch.rover import drive, drive_in_chunks, told
from tests.robomend_batch.running import batch_run, intervals, logs, tree

from robomend_client.observers import Driver
from robomend_client.observers.base import SECOND


def _silence() -> list[Sample]:
    return [sample for sample in drive() if sample[1] == "scan"]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_of_the_chunk_in_which_an_mcap_ends_what_is_there_is_read(
    compression: CompressionType, rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    observers.write_text("topics:\n  scan: {rate_hz: 10, tolerance_hz: 2}\n")
    log = tmp_path / "a.mcap"
    with log.open("wb") as file:
        options: dict[str, Any] = {
            "chunk_size": 10 << 20,
            "index_types": IndexType.NONE,
        }  # one chunk is nearly all of it
        drive_in_chunks(file, drive(60.0), compression=compression, **options)
    assert batch_run(tmp_path / "whole", log, "--observers", observers, model=model) == 0
    whole = log.read_bytes()
    for share in (0.5, 0.8):
        log.write_bytes(whole[: int(len(whole) * share)])
        given = (log, "--observers", observers, "--overwrite")
        assert batch_run(tmp_path / "cut", *given, model=model) == 2
        (record,) = logs(tmp_path / "cut")
        assert record["state"] == "ended-early"
        assert share - 0.3 < (record["end_ns"] - EPOCH_NS) / (60 * SECOND) <= share + 0.2
        assert told(tmp_path / "cut")[:-1] == told(tmp_path / "whole")[: len(told(tmp_path / "cut")) - 1]


def test_a_recording_that_goes_back_in_time_has_segments(rover: tuple[Path, Path], tmp_path: Path) -> None:
    """A simulation that was reset: by the recorder's clock time goes on, by the headers it begins again."""
    model, observers = rover
    record = Recorder(tmp_path / "a.mcap")
    for number in range(80):
        seconds, tenths = divmod(number % 40, 10)
        stamp = {"sec": EPOCH_NS // SECOND + seconds, "nanosec": tenths * SECOND // 10}
        record(number / 10, "/scan", KINDS["scan"], header={"stamp": stamp})
    given = ("--observers", observers, "--time", "header")
    assert batch_run(tmp_path / "out", record.write(), *given, model=model) == 0
    found = intervals(tmp_path / "out")
    assert {one["segment"] for one in found} == {0, 1}
    assert all(one["end_ns"] >= one["start_ns"] for one in found)
    assert [one["state"] for one in found if one["segment"] == 1] == ["unknown", "healthy"]


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_statistics": False},
        {"use_summary_offsets": False, "repeat_channels": False},
    ],
    ids=lambda options: next(iter(options)),
)
def test_a_file_without_index_is_read_as_a_stream(
    options: dict[str, Any], rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    with (tmp_path / "a.mcap").open("wb") as file:
        drive_in_chunks(file, _silence(), topics=("scan",), **options)
    assert batch_run(tmp_path / "out", tmp_path / "a.mcap", "--observers", observers, model=model) == 0
    (fault,) = [start for start, state, _ in told(tmp_path / "out") if state == "faulty"]
    assert 3.0 < fault < 3.5


def test_messages_out_of_order_are_put_in_order_by_the_index(
    rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    scans = _silence()
    blocks = [scans[start : start + 7] for start in range(0, len(scans), 7)]
    pairs = zip(blocks[1::2], blocks[::2], strict=False)
    mixed = [scan for pair in pairs for block in pair for scan in block]
    for name, in_order in (("a", False), ("b", True)):
        with (tmp_path / f"{name}.mcap").open("wb") as file:
            drive_in_chunks(file, mixed, in_order, topics=("scan",), chunk_size=1000)
        given = tmp_path / f"{name}.mcap", "--observers", observers
        assert batch_run(tmp_path / name, *given, model=model) == 0
    assert told(tmp_path / "a") == told(tmp_path / "b")


def test_a_type_that_cannot_be_parsed_costs_its_topic_and_not_the_file(
    rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="test")
        odd = writer.register_schema("my_msgs/msg/Odd", "ros2msg", b"%%% no definition at all")
        channels = [writer.register_channel(f"/{topic}", "cdr", odd) for topic in ("odom", "scan")]
        for time, *_ in _silence():
            for channel in channels:
                writer.add_message(channel, EPOCH_NS + round(time * SECOND), b"\0\1\0\0", 0)
        writer.finish()  # type: ignore[no-untyped-call]  # the library's
    assert batch_run(tmp_path / "out", tmp_path / "a.mcap", "--observers", observers, model=model) == 2
    (log,) = logs(tmp_path / "out")
    assert log["state"] == "bad"
    (problem,) = [problem for problem in log["problems"] if problem["bad"]]
    assert "odom:twist.twist.angular.z" in problem["reason"]
    assert "\n" not in problem["reason"]  # whatever a library's error looks like
    assert [start for start, state, _ in told(tmp_path / "out") if state == "faulty"]  # by the rate of scan


def test_stretches_that_are_taken_in_at_once_leave_the_same_bytes(
    rover: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, observers = rover
    observers.write_text(
        "topics:\n  odom: {rate_hz: 20, tolerance_hz: 3}\n  scan: {rate_hz: 10, tolerance_hz: 2}\n"
        'observers:\n  "ok(hokuyo)": {kind: property, source: "odom:twist.twist.angular.z", high: 1.5}\n'
    )
    with (tmp_path / "a.mcap").open("wb") as file:
        drive_in_chunks(file, drive(20.0))
    taken = []
    take = Driver.quiet

    def counted(driver: Driver, *given: Any) -> bool:
        taken.append(take(driver, *given))
        return taken[-1]

    monkeypatch.setattr(Driver, "quiet", counted)
    assert batch_run(tmp_path / "fast", tmp_path / "a.mcap", "--observers", observers, model=model) == 0
    assert taken.count(True) > 10
    assert taken.count(False) > 2
    monkeypatch.setattr(Driver, "quiet", lambda *_: False)
    assert batch_run(tmp_path / "slow", tmp_path / "a.mcap", "--observers", observers, model=model) == 0
    assert tree(tmp_path / "fast") == tree(tmp_path / "slow")
    states = [state for _, state, _ in told(tmp_path / "fast")]
    assert states.count("faulty") >= 2
