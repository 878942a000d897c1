"""The scenarios, played by the demo as a user starts it: golden outcomes, nothing left behind."""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import signal
import socket
import subprocess
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from tests.clients.service_double import eventually
from tests.forked import popen
from tests.once import made_once
from tests.robomend_demo.playing import END_S, Playing, play, playing
from tests.terminal import AFTER_CTRL_C

DEVICES = {"jaguar", "hokuyo", "laser_alignment"}
NODES = {
    "jaguar_node",
    "hokuyo_node",
    "laser_alignment_node",
    "imu_node",
    "joy_node",
    "jaguar_teleop_node",
    "hector_mapping",
    "rviz",
    "laser_alignment_control",
}
DRIVERS = {
    "jaguar": "jaguar_node",
    "hokuyo": "hokuyo_node",
    "laser_alignment": "laser_alignment_node",
}
RESTART = ["power_up(jaguar)", "stop_node(jaguar_node)", "start_node(jaguar_node)"]

RESTART_LIDAR = ["stop_node(hokuyo_node)", "start_node(hokuyo_node)"]
CYCLE_LIDAR = ["shutdown(hokuyo)", "power_up(hokuyo)"]


@pytest.fixture(scope="session")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """Both scenarios of the paper, played once for all tests, also where several processes run them."""
    return played(tmp_path_factory, "both-scenarios", play_both)


@pytest.fixture(scope="session")
def broken_devices(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """The scenarios in which a device breaks, likewise."""
    options = ("--scenario", "dead-lidar", "--scenario", "hung-device")
    return played(tmp_path_factory, "broken-devices", lambda folder: play(folder, *options))


def played(
    tmp_path_factory: pytest.TempPathFactory, name: str, play_it: Callable[[Path], object]
) -> tuple[dict[str, Any], Path]:
    """Return what a demo printed, and its report folder; the first who asks plays it."""
    folder = made_once(tmp_path_factory, name, play_it)
    return json.loads((folder / "out").read_text()), folder / "report"


def play_both(folder: Path) -> None:
    """Play both, with the usual ports taken and the settings of another service around."""
    with ExitStack() as stack:
        for port in (8600, 5000, 5001):
            taken = stack.enter_context(socket.socket())
            with contextlib.suppress(OSError):  # somebody else has it, which is as good
                taken.bind(("127.0.0.1", port))
                taken.listen()
        elsewhere = {"ROBOMEND_DATABASE": "postgresql://nobody@127.0.0.1:1/none", "ROBOMEND_PORT": "8600"}
        play(folder, environment=elsewhere)


def scenario(printed: dict[str, Any], name: str) -> dict[str, Any]:
    return next(one for one in printed["scenarios"] if one["name"] == name)


def test_power_up_is_planned_from_the_one_diagnosis_once_every_observer_was_heard(
    both: tuple[dict[str, Any], Path],
) -> None:
    power_up = scenario(both[0], "power-up")
    assert power_up["repaired"] is True
    assert set(power_up["diagnosis"]["bad"]) == DEVICES | NODES
    assert set(power_up["diagnosis"]["good"]) == {"imu", "joystick"}


def test_power_up_powers_the_devices_before_it_starts_their_drivers(
    both: tuple[dict[str, Any], Path],
) -> None:
    plan = scenario(both[0], "power-up")["plan"]
    assert {step for step in plan if step.startswith("power_up")} == {f"power_up({d})" for d in DEVICES}
    assert {step for step in plan if step.startswith("start_node")} == {f"start_node({n})" for n in NODES}
    for device, driver in DRIVERS.items():
        assert plan.index(f"power_up({device})") < plan.index(f"start_node({driver})")


def test_shut_down_is_diagnosed_as_the_base_and_repaired_by_one_plan(
    both: tuple[dict[str, Any], Path],
) -> None:
    shut_down = scenario(both[0], "shut-down")
    assert shut_down["repaired"] is True
    assert shut_down["diagnosis"]["bad"] == ["jaguar"]
    assert shut_down["plan"] == RESTART


def test_a_hung_device_is_cycled_after_its_drivers_restart_did_not_help(
    broken_devices: tuple[dict[str, Any], Path],
) -> None:
    hung = scenario(broken_devices[0], "hung-device")
    assert hung["repaired"] is True
    assert [done["diagnosis"]["bad"] for done in hung["rounds"]] == [["hokuyo_node"], ["hokuyo"]]
    assert [done["plan"] for done in hung["rounds"]] == [RESTART_LIDAR, [*CYCLE_LIDAR, *RESTART_LIDAR]]


def test_a_dead_lidar_is_replaced_by_its_spare_once_nothing_else_is_left(
    broken_devices: tuple[dict[str, Any], Path],
) -> None:
    printed, report = broken_devices
    dead = scenario(printed, "dead-lidar")
    assert dead["repaired"] is True
    # It hung a moment ago: to restart its driver was no help, and its power cycle did not last.
    assert dead["diagnosis"]["bad"] == ["hokuyo"]
    assert dead["plan"] == ["switch_to_spare(hokuyo, hokuyo_b)", *RESTART_LIDAR]
    text = "".join(ET.parse(report / "dead-lidar.svg").getroot().itertext())
    assert "switch_to_spare(hokuyo, hokuyo_b)" in text
    assert "hokuyo_b" in text


def test_the_account_of_each_repair_is_told_after_it(broken_devices: tuple[dict[str, Any], Path]) -> None:
    printed, report = broken_devices
    said = (report.parent / "said").read_text()
    for one in printed["scenarios"]:
        account = one["account"]
        assert "repair r-" in account[0]
        assert any(re.search("chosen: hokuyo: helps (with|whichever)", line) for line in account)
        assert account[-1].endswith("repaired: every observation is what a healthy robot would show")
        assert all(f"    {line}\n" in said for line in account)


def test_demo_json_tells_of_each_event_and_of_every_figure(both: tuple[dict[str, Any], Path]) -> None:
    for one in both[0]["scenarios"]:
        times = [event["t_s"] for event in one["events"]]
        assert times == sorted(times)
        assert {"observations", "diagnosis", "repair", "action"} <= {event["kind"] for event in one["events"]}
        own = one["figures"]
        assert 0 < own["service_share_s"] < own["total_s"] + own["detection_s"]
        assert 0 < own["observation_to_diagnosis_ms"]["p50"] <= own["observation_to_diagnosis_ms"]["max"]
        assert own["diagnosis_to_plan_ms"] > 0


def test_the_report_holds_both_timelines_and_the_same_json(both: tuple[dict[str, Any], Path]) -> None:
    printed, report = both
    assert json.loads((report / "demo.json").read_text()) == printed
    for name in ("power-up", "shut-down"):
        text = "".join(ET.parse(report / f"{name}.svg").getroot().itertext())
        assert "power_up(jaguar)" in text
        assert "laser_alignment_control" in text
    assert sorted(file.name for file in report.iterdir()) == ["demo.json", "power-up.svg", "shut-down.svg"]


# --- ending early ----------------------------------------------------------------------------------------


def test_ctrl_c_at_any_moment_leaves_nothing_behind(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    moments = 25 if request.config.getoption("--long") else 1
    draw = random.Random(os.urandom(8))
    for number in range(moments):
        after_s = draw.uniform(0.3, 9.0)
        start = popen if number % 3 else subprocess.Popen  # a fresh one is ended while it is loaded, too
        with playing(tmp_path / str(number), start=start) as demo:
            time.sleep(after_s)  # a random moment
            demo.process.send_signal(signal.SIGINT)
            assert demo.process.wait(END_S) in {*AFTER_CTRL_C, 0}, (after_s, demo.said())
            # On a busy computer the interpreter itself is not ready yet: nothing of ours could catch it.
            ours = "Traceback" in demo.said() and re.search(r'File ".*robomend', demo.said())
            assert not ours, (after_s, demo.said())
            demo.nothing_is_left()


def test_the_papers_domain_needs_two_rounds_for_the_lost_power_and_ctrl_c_while_it_holds_is_the_ordinary_end(
    tmp_path: Path,
) -> None:
    options = ("--domain", "paper", "--hold", "--format", "json")
    with playing(tmp_path / "held", *options, start=popen) as demo:
        demo.until_said("Ctrl-C ends it")
        shut_down = scenario(json.loads((demo.folder / "out").read_text()), "shut-down")
        demo.process.send_signal(signal.SIGINT)
        assert demo.process.wait(END_S) == 0, demo.said()
        demo.nothing_is_left()
    assert shut_down["repaired"] is True
    assert shut_down["diagnosis"]["bad"] == ["jaguar"]
    assert [done["diagnosis"]["bad"] for done in shut_down["rounds"]] == [["jaguar"], ["jaguar_node"]]
    assert [done["plan"] for done in shut_down["rounds"]] == [RESTART[:1], RESTART[1:]]


def test_kill_9_of_the_demo_ends_its_parts_and_the_next_one_sweeps_its_folder(tmp_path: Path) -> None:
    with playing(tmp_path / "killed", "--scenario", "shut-down") as demo:
        demo.until_said("shut-down:")
        assert len(demo.parts()) > len(NODES)
        demo.process.kill()
        demo.process.wait(END_S)
        eventually(lambda: not demo.parts(), "no process is left")
        (left,) = demo.scratch
    following = {"TMPDIR": str(left.parent)}
    with playing(tmp_path / "next", environment=following) as demo:
        eventually(lambda: not left.exists(), "the old folder is gone", 60)


# --- what goes wrong -------------------------------------------------------------------------------------


def failed(demo: Playing) -> str:
    """Wait for the demo to fail; return what it said, with nothing left behind."""
    assert demo.process.wait(END_S) == 3, demo.said()
    demo.nothing_is_left()
    assert "Traceback (most recent call last)" not in demo.said().partition("its log ends")[0]
    return demo.said()


def test_a_part_that_ends_in_the_middle_is_named_with_its_log(tmp_path: Path) -> None:
    with playing(tmp_path / "board", "--scenario", "shut-down", start=popen) as demo:
        demo.until_said("diagnosis: healthy")
        os.kill(demo.part("robomend_board.main"), signal.SIGTERM)
        assert "board ended with exit code 0 in the middle; its log ends" in failed(demo)


def test_a_report_folder_that_cannot_be_written_is_refused_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with playing(tmp_path / "refused", "--report", str(tmp_path / "file" / "report")) as demo:
        assert demo.process.wait(END_S) == 2
        assert "name a folder that can be written" in demo.said()
        assert demo.scratch == []
