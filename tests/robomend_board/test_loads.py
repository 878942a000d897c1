"""Loads come from a file; a wrong one is refused with the place and what is allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomend_board.loads import Load, LoadsError, Supply, default_rig, read_rig


def test_the_default_is_the_device_map_of_the_historic_board() -> None:
    names = [load.name for load in default_rig(10).loads]
    assert names == [
        "sensor_head",
        "laser_alignment",
        "pc",
        "hokuyo",
        "kinect",
        "router",
        "thermal_camera",
        "jaguar",
        "",
        "",
    ]


def test_a_file_gives_the_supply_and_the_loads_that_it_lists(tmp_path: Path) -> None:
    path = tmp_path / "loads.yaml"
    path.write_text("supply: {voltage_v: 12}\nchannels:\n  1: {name: arm, steady_a: 2, inrush_a: 4}\n")
    rig = read_rig(path, 3)
    assert rig.supply == Supply(voltage_v=12.0)
    assert rig.loads == (Load(), Load("arm", 2.0, 4.0), Load())


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("- 1", "a mapping with the keys supply and channels"),
        ("channels: [1]", "from channel numbers"),
        ("channels: {3: {}}", "none of the channels 0 to 2"),
        ("channels: {1: {ampere: 3}}", "channels: 1: .*steady_a"),
        ("channels: {1: {steady_a: much}}", "steady_a is 'much'"),
        ("channels: {1: {steady_a: -1}}", "steady_a is -1"),
        ("channels: {1: {inrush_s: 0}}", "above 0"),
        ("{", "loads.yaml"),
    ],
)
def test_a_wrong_file_is_refused_with_the_place(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "loads.yaml"
    path.write_text(text)
    with pytest.raises(LoadsError, match=says) as refused:
        read_rig(path, 3)
    assert "loads.yaml" in str(refused.value)
