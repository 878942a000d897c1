"""Figures of the robot's side: what is counted is right, and every part runs."""

from __future__ import annotations

import json
import queue
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.packages import KILTED
from tests.ros1 import ros1
from tests.ros2 import domain, ros2

from robomend_bench.robots import command as streams
from robomend_bench.robots import live
from robomend_bench.robots import ros as bench_ros
from robomend_bench.robots.command import PARTS, command
from robomend_client.events import Event, Kind
from robomend_client.observers import GeneralObserver, Rate

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


def test_a_real_ros_1_robot_gives_its_figures(long: bool) -> None:
    if not long:
        pytest.skip("a service, a robot and two agents that wait for their own time-outs: --long runs it")
    ros1()
    small = ["--only", "ros1", "--nodes", "1", "--seconds", "0.5", "--format", "json"]
    found = json.loads(CliRunner().invoke(command, small, catch_exceptions=False).stdout)["ros1"]
    assert found["killed"]["count"] == found["frozen"]["count"] == found["silent"]["count"] == 1
    assert found["silent"]["median_s"] >= 0.35  # from the last message on
    assert found["frozen"]["median_s"] > 1.0  # the time-out of a question
    assert 10 < found["raw_mb"] < found["fields_mb"]  # rosbags is loaded when a field is read
    assert found["raw_core"] > 0


def test_a_real_ros_2_robot_gives_its_figures(long: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not long:
        pytest.skip("a service, a robot and two agents that wait for their own time-outs: --long runs it")
    ros2()
    monkeypatch.setattr(bench_ros, "ROS2_PYTHONS", (str(KILTED.python),))
    small = ["--only", "ros2", "--nodes", "1", "--seconds", "3", "--format", "json"]
    found = json.loads(CliRunner().invoke(command, small, catch_exceptions=False).stdout)["ros2"]
    assert found["killed"]["count"] == found["frozen"]["count"] == found["silent"]["count"] == 1
    assert found["silent"]["median_s"] >= 0.35  # from the last message on
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


def test_without_ros_2_nothing_is_measured_and_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_ros, "ROS2_PYTHONS", ("/bin/false",))
    done = CliRunner().invoke(command, ["--only", "ros2"], catch_exceptions=False)
    assert "| ros2 | missing | no rclpy" in done.stdout


def test_without_ros_1_nothing_is_measured_and_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_ros, "ROS1_PYTHON", "/bin/false")
    done = CliRunner().invoke(command, ["--only", "ros1"], catch_exceptions=False)
    assert "| ros1 | missing | no rospy" in done.stdout


def test_an_unknown_part_is_refused() -> None:
    done = CliRunner().invoke(command, ["--only", "speed,wings"])
    assert done.exit_code == 2
    assert "'wings' is none of speed" in done.output


def test_an_observer_that_is_easily_alarmed_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        streams, "GeneralObserver", lambda topic, rate: GeneralObserver(topic, Rate(10, silence_s=0.101))
    )
    assert streams.alarms(1000, 1, streams.LOST, Rate()) > 10


def test_what_loses_more_than_its_observer_bears_is_counted_and_a_larger_lost_bears_it() -> None:
    assert streams.alarms(20_000, 1, 0.05, Rate(10, 2)) > 10
    assert streams.alarms(20_000, 1, 0.05, Rate(10, 2, lost=12)) == 0


def test_a_topic_that_was_late_before_its_last_message_is_silenced_once_more() -> None:
    rig = object.__new__(live.Rig)
    rig._events, rig._holds = queue.Queue(), {"ok(a)": True}
    last_ns = iter((5_000_000_000, 5_000_000_000, 9_000_000_000))

    def switch() -> int:
        return next(last_ns)

    def tell(at_s: float, *changed: str) -> None:
        event = {"accepted_ns": round(at_s * 1e9), "changed": list(changed)}
        rig._events.put(Event(1, 0, Kind.OBSERVATIONS, "bench", event))

    tell(5.1, "not ok(a)")  # it rests on a silence before the message of 5 s
    tell(8.0, "ok(a)")
    tell(9.4, "not ok(a)")
    assert rig.silence_s("a", switch) == pytest.approx(0.4)


def test_what_is_never_told_is_an_error_that_names_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(live, "WITHIN_S", 0.01)
    rig = object.__new__(live.Rig)
    rig._events, rig._holds = queue.Queue(), {"running(a)": True}
    with pytest.raises(live.NotTold, match=r"running\(b\): True"):
        rig.told({"running(a)": True, "running(b)": True})
