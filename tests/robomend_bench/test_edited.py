"""Faults that are put into recordings by editing: each edit is what it says, and what is told is counted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from robomend_bench.batch import drives
from robomend_bench.batch.command import command
from robomend_bench.batch.edited import (
    EDITS,
    Change,
    Message,
    Watched,
    edited,
    read,
)

BEGIN_NS = drives.BEGIN_S * 10**9
START_NS, STOP_NS = BEGIN_NS + 20 * 10**9, BEGIN_NS + 30 * 10**9
GYRO = Watched("gyro", "imu_node", "data", -1.0, 1.0)


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    file = tmp_path_factory.mktemp("drive") / "drive.bag"
    return read(drives.write(file, drives.robot(1), 1, 60))


def of_gyro(messages: list[Message]) -> list[tuple[int, float]]:
    """Return times and values in the time that is edited."""
    return [
        (one.time_ns, Change(one.connection, "data").value(one.data))
        for one in messages
        if one.connection.topic == "/gyro" and START_NS <= one.time_ns < STOP_NS
    ]


def test_each_edit_changes_its_topic_in_its_time_and_nothing_else(messages: list[Message]) -> None:
    was = of_gyro(messages)
    now = {kind: edited(messages, GYRO, kind, START_NS, STOP_NS) for kind in GYRO.edits}
    assert of_gyro(now["dropped"]) == []
    assert of_gyro(now["thinned"]) == was[::2]
    assert of_gyro(now["frozen"]) == [(time_ns, was[0][1]) for time_ns, _ in was]
    grown = [new - old for (_, new), (_, old) in zip(of_gyro(now["ramped"]), was, strict=True)]
    assert grown == pytest.approx([2.0 * (time_ns - START_NS) / 1e9 for time_ns, _ in was])
    others = [one for one in messages if one.time_ns not in {time_ns for time_ns, _ in was}]
    for found in now.values():
        kept = {time_ns for time_ns, _ in of_gyro(found)}
        assert [one for one in found if one.time_ns not in kept] == others


def test_what_is_told_of_edited_recordings_is_counted_and_so_is_what_cannot_be_read(tmp_path: Path) -> None:
    sources = (drives.Source("base_node", "odom", 8.0, 0.003, 0, 0.3, True, True, turn=True),)
    drives.write(tmp_path / "a.bag", drives.Robot("small", sources, "base_node", 45.0), 1, 240)
    (tmp_path / "bad.bag").write_bytes(b"#ROSBAG V2.0\nnothing more")
    asked = ["--only", "edited", "--bags", str(tmp_path), "--format", "json"]
    found = json.loads(CliRunner().invoke(command, asked, catch_exceptions=False).stdout)["edited"]
    assert (found["recordings"], found["unedited_s"]) == (1, pytest.approx(120, abs=1))
    assert [reason.split(":")[0] for reason in found["refused"]] == ["bad.bag"]
    assert (found["false_alarms"], found["alarms"], found["missed"]) == ({}, [], [])
    assert found["planted"] == found["found"] == dict.fromkeys(EDITS, 1)
