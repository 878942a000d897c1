"""MCAP files as they come: cut off, without an index, out of order, of types that nobody knows."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from tests.robomend_batch.recordings import EPOCH_NS, steady
from tests.robomend_batch.rover import drive, drive_in_chunks, told
from tests.robomend_batch.running import batch_run, intervals, logs, tree

from robomend_client.observers import Driver
from robomend_client.observers.base import SECOND


def _scans(file: object, times: list[tuple[float, float]], **options: object) -> None:
    """Write scans, recorded and stamped at these seconds, by another library than the one that reads."""
    writer = McapWriter(file, chunk_size=1000, **options)  # type: ignore[arg-type]  # handed through
    writer.start(profile="ros2", library="test")
    definition = "std_msgs/Header header\nfloat32 range\n" + "=" * 80 + "\nMSG: std_msgs/Header\n"
    definition += "builtin_interfaces/Time stamp\nstring frame_id\n" + "=" * 80
    definition += "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    schema = writer.register_schema("my_msgs/msg/Scan", "ros2msg", definition.encode())
    channel = writer.register_channel("/scan", "cdr", schema)
    for recorded, stamped in times:
        at_ns, stamp_ns = (EPOCH_NS + round(time * SECOND) for time in (recorded, stamped))
        data = (
            b"\0\1\0\0"
            + struct.pack("<iII", *divmod(stamp_ns, SECOND), 2)
            + b"x\0\0\0"
            + struct.pack("<f", 1.5)
        )
        writer.add_message(channel, at_ns, data, at_ns)
    writer.finish()  # type: ignore[no-untyped-call]  # the library's


def _silence() -> list[tuple[float, float]]:
    return [(time, time) for time, topic, _ in drive() if topic == "scan"]


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
    first = steady("scan", 10, 4.0)
    log = tmp_path / "a.mcap"
    with log.open("wb") as file:
        _scans(file, [(time, time) for time, _, _ in first] + [(4 + time, time) for time, _, _ in first])
    given = ("--observers", observers, "--time", "header")
    assert batch_run(tmp_path / "out", log, *given, model=model) == 0
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
    options: dict[str, object], rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    with (tmp_path / "a.mcap").open("wb") as file:
        _scans(file, _silence(), **options)
    assert batch_run(tmp_path / "out", tmp_path / "a.mcap", "--observers", observers, model=model) == 0
    (fault,) = [start for start, state, _ in told(tmp_path / "out") if state == "faulty"]
    assert 3.0 < fault < 3.5


def test_messages_out_of_order_are_put_in_order_by_the_index(
    rover: tuple[Path, Path], tmp_path: Path
) -> None:
    model, observers = rover
    times = _silence()
    blocks = [times[start : start + 7] for start in range(0, len(times), 7)]
    mixed = [
        time for pair in zip(blocks[1::2], blocks[::2], strict=False) for block in pair for time in block
    ]
    with (tmp_path / "a.mcap").open("wb") as file:
        _scans(file, mixed)
    with (tmp_path / "b.mcap").open("wb") as file:
        _scans(file, sorted(mixed))
    for name in ("a", "b"):
        assert (
            batch_run(tmp_path / name, tmp_path / f"{name}.mcap", "--observers", observers, model=model) == 0
        )
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
        for time, _ in _silence():
            for channel in channels:
                writer.add_message(channel, EPOCH_NS + round(time * SECOND), b"\0\1\0\0", 0)
        writer.finish()  # type: ignore[no-untyped-call]  # the library's
    assert batch_run(tmp_path / "out", tmp_path / "a.mcap", "--observers", observers, model=model) == 2
    (log,) = logs(tmp_path / "out")
    assert log["state"] == "bad"
    (problem,) = [problem for problem in log["problems"] if problem["bad"]]
    assert "odom:twist.twist.angular.z" in problem["reason"]
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
