"""Figures of the robot's side: what is counted is right, and every part runs."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner
from tests.packages import KILTED
from tests.ros1 import ros1
from tests.ros2 import domain, ros2

from robomend_bench.robots import command as streams
from robomend_bench.robots import ros as bench_ros
from robomend_bench.robots.command import PARTS, command
from robomend_client.observers import Rate

SMALL = ("--samples", "1000", "--repeats", "1", "--messages", "1000", "--nodes", "2")


def test_every_part_gives_its_figures() -> None:
    ours = [part for part in PARTS if not part.startswith("ros")]
    small = [*SMALL, "--only", ",".join(ours), "--format", "json"]
    done = CliRunner().invoke(command, small, catch_exceptions=False)
    found = json.loads(done.stdout)
    assert list(found) == ours
    assert all(speed["median"] > 0 for speed in found["speed"].values())
    [silence] = found["silence"].values()
    assert 0.35 <= silence["median_s"] <= silence["max_s"]
    assert found["alarms"]["messages"] == 1000
    assert found["alarms"]["default settings"]["0.1%"] == 0
    assert found["live"]["killed"]["count"] == found["live"]["silent"]["count"] == 2
    assert found["live"]["silent"]["median_s"] >= 0.35  # from the last message on
    assert found["live"]["alone_mb"] > 10


@pytest.mark.parametrize(("over", "seconds"), [("ros1", "0.5"), ("ros2", "3")])
def test_a_real_robot_gives_its_figures(
    over: str, seconds: str, long: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not long:
        pytest.skip("a service, a robot and two agents that wait for their own time-outs: --long runs it")
    if over == "ros1":
        ros1()
    else:
        ros2()
        monkeypatch.setattr(bench_ros, "ROS2_PYTHONS", (str(KILTED.python),))
    small = ["--only", over, "--nodes", "1", "--seconds", seconds, "--format", "json"]
    found = json.loads(CliRunner().invoke(command, small, catch_exceptions=False).stdout)[over]
    assert found["killed"]["count"] == found["frozen"]["count"] == found["silent"]["count"] == 1
    assert found["silent"]["median_s"] >= 0.35  # from the last message on
    assert over == "ros2" or found["frozen"]["median_s"] > 1.0  # the time-out of a question
    assert 10 < found["raw_mb"] < found["fields_mb"]  # rosbags is loaded when a field is read
    assert found["raw_core"] > 0


@pytest.mark.parametrize("over", ["ros1", "ros2"])
def test_the_papers_scenarios_are_repaired_with_nodes_of_a_real_ros(
    over: str, long: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not long:
        pytest.skip("nine interpreters with ROS, a service and a board: --long runs it")
    if over == "ros1":
        ros1()
    else:
        ros2()
        monkeypatch.setattr(bench_ros, "ROS2_PYTHONS", (str(KILTED.python),))
    part = f"{over}-power"
    small = ["--only", part, "--robots", "1", "--format", "json"]
    with domain() as number:
        monkeypatch.setattr(bench_ros, "choose_domain", lambda: number)
        found = json.loads(CliRunner().invoke(command, small, catch_exceptions=False).stdout)[part]
    assert found["power-up"]["count"] == found["shut-down"]["count"] == 1
    assert found["power-up"]["median_s"] > 1.0  # nodes that drive a device start when it is on
    assert found["shut-down"]["median_s"] > 0.5  # silence is known after 0.35 s


def test_what_loses_more_than_its_observer_bears_is_counted_and_a_larger_lost_bears_it() -> None:
    assert streams.alarms(20_000, 1, 0.05, Rate(10, 2)) > 10
    assert streams.alarms(20_000, 1, 0.05, Rate(10, 2, lost=12)) == 0


@pytest.mark.parametrize(
    ("setting", "value", "said"),
    [
        ("ROS1_PYTHON", "/bin/false", "ros1 | missing | no rospy"),
        ("ROS2_PYTHONS", ("/bin/false",), "ros2 | missing | no rclpy"),
    ],
)
def test_without_ros_nothing_is_measured_and_that_is_said(
    setting: str, value: object, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_ros, setting, value)
    done = CliRunner().invoke(command, ["--only", said[:4]], catch_exceptions=False)
    assert f"| {said}" in done.stdout
