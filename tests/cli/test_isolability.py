"""`robomend model check --isolability`, as a user calls it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from robomend.cli.commands import run
from robomend.resources import resource

TEDUSAR = str(resource("examples", "tedusar.yaml"))
Capture = pytest.CaptureFixture[str]


MOWER = """\
robomend: 1
name: mower
hardware:
  gps: {channel: 4}
  wheels: {channel: 7}
nodes:
  gps_node: {drives: [gps], publishes: {fix: []}}
  wheel_node: {drives: [wheels], publishes: {odom: []}}
  localizer: {publishes: {pose: [fix, odom]}}
  planner: {publishes: {path: [pose]}}
"""
ARM = """\
robomend: 1
name: arm
hardware:
  hub: {channel: 1, cost: 3}
  gripper: {channel: 2, fed_by: [hub]}
  camera: {channel: 3, fed_by: [hub]}
nodes:
  gripper_driver: {drives: [gripper], publishes: {gripper_state: []}}
  camera_driver: {drives: [camera], publishes: {image: []}}
  grasp: {publishes: {grasp_pose: [image, gripper_state]}}
"""
BOAT = """\
robomend: 1
name: boat
blame_hardware: true
hardware:
  sonar: {}
  imu: {channel: 5}
nodes:
  sonar_node: {drives: [sonar], publishes: {depth: []}}
  imu_node: {drives: [imu], publishes: {attitude: []}}
  pilot: {publishes: {rudder: [depth, attitude]}}
"""


def told(capsys: Capture, *arguments: str) -> str:
    assert run(["model", "check", TEDUSAR, "--isolability", *arguments]) == 0
    return capsys.readouterr().out


def observed(capsys: Capture, *arguments: str) -> set[str]:
    return set(json.loads(told(capsys, *arguments, "--format", "json"))["observed"])


def test_groups_are_told_with_a_table_and_what_to_watch(capsys: Capture) -> None:
    out = told(capsys, "-o", "ok(odom)")
    assert "jaguar and jaguar_node cannot be told apart: watch whether jaguar is on (channel 7)" in out
    assert "\n  jaguar_node              - + +" in out
    assert "complete, by signatures" in out


def test_what_a_robot_reports_is_at_hand_and_so_is_its_board(capsys: Capture, tmp_path: Path) -> None:
    board = {"host": "10.0.0.2", "port": 5000, "expected_currents": {}}
    config = {"model": "tedusar", "observed": ["ok(scan)", "not ok(odom)"], "board": board}
    file = tmp_path / "robot.json"
    for body in (config, {"id": "r1", "config": config}):
        file.write_text(json.dumps(body))
        assert observed(capsys, "--robot", str(file)) == {
            "ok(scan)", "ok(odom)", "on(jaguar)", "on(hokuyo)", "on(laser_alignment)",
        }  # fmt: skip
    file = tmp_path / "robot.yaml"
    file.write_text("model: tedusar\nobserved: [ok(scan), not ok(odom)]\n")
    assert observed(capsys, "--robot", str(file)) == {"ok(scan)", "ok(odom)"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--isolability", "-o", "ok(scam)"], "scan"),
        (["--isolability", "--timeout", "0"], "above 0"),
        (["--double"], "--isolability"),
    ],
)
def test_bad_input_is_refused(arguments: list[str], words: str, capsys: Capture) -> None:
    assert run(["model", "check", TEDUSAR, *arguments]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("text", ["{", "model: 5"])
def test_a_configuration_that_is_none_is_refused(text: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "robot.json").write_text(text)
    assert run(["model", "check", TEDUSAR, "--isolability", "--robot", str(tmp_path / "robot.json")]) == 2
    assert "robot.json" in capsys.readouterr().err


def followed(sentence: str) -> str:
    """Return the option that watches what a sentence says to watch."""
    if on := re.fullmatch(r"whether (\w+) is on(?: \(channel \d+\))?", sentence):
        return f"on({on[1]})"
    if runs := re.fullmatch(r"whether (\w+) runs", sentence):
        return f"running({runs[1]})"
    if tested := re.fullmatch(r"a self-test of (\w+), or .*", sentence):
        return f"ok(self_test,{tested[1]})"
    assert re.fullmatch(r"\w+", sentence), sentence
    return f"ok({sentence})"


@pytest.mark.parametrize(
    ("model", "watched", "group"),
    [
        (MOWER, ["ok(path)"], "gps, wheels, gps_node, wheel_node, localizer and planner"),
        (ARM, ["ok(grasp_pose)", "ok(image)"], "gripper, gripper_driver and grasp"),
        (BOAT, ["ok(rudder)", "ok(attitude)"], "sonar, sonar_node and pilot"),
    ],
)
def test_who_follows_the_words_sees_ambiguous_groups_split(
    capsys: Capture, tmp_path: Path, model: str, watched: list[str], group: str
) -> None:
    file, rules = tmp_path / "model.yaml", list[str]()
    for round_ in range(3):
        file.write_text(model + (f"rules: {json.dumps(rules)}\n" if rules else ""))
        options = [word for atom in watched for word in ("-o", atom)]
        assert run(["model", "check", str(file), "--isolability", *options]) == 0
        out = capsys.readouterr().out
        if "cannot be told" not in out:
            break
        assert round_ or f"{group} cannot be told apart" in out
        for said in re.findall(r"cannot be told .*?: watch (.*); [\d.]+ s", out):
            watched = [*watched, *map(followed, re.split(r", | and ", said))]
        for rule, said in re.findall(r"^  `(.*)` would: watch (.*)$", out, re.MULTILINE):
            rules.append(rule)
            watched = [*watched, followed(said)]
    assert "cannot be told" not in out
    assert "cannot be detected" not in out
    assert "complete" in out
