"""`robomend plan`: the paper's two scenarios from the command line, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robomend.cli.commands import run
from robomend.resources import resource

TEDUSAR = str(resource("examples", "tedusar.yaml"))
OFF = [
    "not on(jaguar) and not on(hokuyo) and not on(laser_alignment)",
    *(
        f"not running({name})"
        for name in (
            "jaguar_node",
            "hokuyo_node",
            "laser_alignment_node",
            "imu_node",
            "joy_node",
            "jaguar_teleop_node",
            "hector_mapping",
            "rviz",
            "laser_alignment_control",
        )
    ),
]


def observing(*sentences: str) -> list[str]:
    return [word for sentence in sentences for word in ("-o", sentence)]


def test_shut_down_is_planned_as_steps_and_as_a_graph(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", TEDUSAR, *observing("not on(jaguar)"), "--planner", "asp", "--format", "json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["choice"]["bad"] == ["jaguar"]
    assert "jaguar_node" in answer["choice"]["good"]
    steps = [step["text"] for step in answer["plan"]["steps"]]
    assert steps == ["power_up(jaguar)", "stop_node(jaguar_node)", "start_node(jaguar_node)"]
    assert answer["plan"]["graph"]["edges"] == [[0, 1], [1, 2]]
    assert answer["plan"]["graph"]["layers"] == [[0], [1], [2]]


def test_power_up_powers_the_devices_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", TEDUSAR, *observing(*OFF), "--format", "json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert set(answer["choice"]["good"]) == {"imu", "joystick"}
    steps = [step["text"] for step in answer["plan"]["steps"]]
    assert {"power_up(jaguar)", "power_up(hokuyo)", "power_up(laser_alignment)"} == set(steps[:3])


def test_a_mute_driver_under_power_is_restarted_before_power_is_cycled(
    capsys: pytest.CaptureFixture[str],
) -> None:
    seen = observing("on(jaguar) and running(jaguar_node)", "not ok(odom)")
    assert run(["plan", TEDUSAR, *seen, "--planner", "asp"]) == 0
    shown = capsys.readouterr().out
    assert "repair jaguar_node" in shown
    assert "alternatives" in shown
    assert "Stop jaguar_node" in shown
    assert "stop_node(jaguar_node)" in shown


def test_a_healthy_robot_and_one_beyond_repair_get_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", TEDUSAR, "--planner", "asp"]) == 0
    assert "nothing to repair" in capsys.readouterr().out
    assert run(["plan", TEDUSAR, "--bad", "imu", "--planner", "asp"]) == 0
    assert "imu: no known action makes it good" in capsys.readouterr().out


def test_the_pddl_is_shown_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", TEDUSAR, "--bad", "rviz", "--planner", "asp", "--pddl", "--format", "json"]) == 0
    pddl = json.loads(capsys.readouterr().out)["plan"]["pddl"]
    assert pddl["domain"].startswith("(define")
    assert "(bad rviz)" in pddl["problem"]


def test_what_is_wrong_is_said_and_the_exit_code_is_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "mine.pddl"
    bad.write_text("(define (domain robot-repair)\n  (:action a))")
    assert run(["plan", TEDUSAR, "--bad", "rviz", "--domain", str(bad)]) == 2
    assert "mine.pddl:2: action 'a' has no :effect" in capsys.readouterr().err
    assert run(["plan", TEDUSAR, "--timeout", "0"]) == 2
    five = tmp_path / "five.yaml"
    five.write_text('ab: "AB"\nnab: "NAB"\nneg_prefix: "not_"\nprops: [on(a)]\nrules: ["NAB(a)->on(a)"]\n')
    assert run(["plan", str(five), "-o", "not on(a)"]) == 2
    assert "needs a component model" in capsys.readouterr().err
