"""`robomend drill` on a robot of processes: asked for, scored, compared; and ended in the middle."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.drills.drilled_robot import DrilledRobot, drilled_robot
from tests.terminal import AFTER_CTRL_C
from tests.waiting import until

from robomend.cli.commands import run
from robomend_demo.cast import observed, tedusar

Capture = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


def drill(
    robot: DrilledRobot, patch: Patch, capsys: Capture, *more: str, said: str = ""
) -> tuple[int, str, str]:
    """Run the command; return its exit code, and what it printed and told."""
    patch.setattr(sys, "stdin", io.StringIO(said))
    capsys.readouterr()
    code = run(["drill", "r1", "--url", robot.url, *more])
    return code, *capsys.readouterr()


def check(robot: DrilledRobot, patch: Patch, capsys: Capture, *which: str) -> dict[str, Any]:
    """Drill, and return the report."""
    code, out, told = drill(robot, patch, capsys, *which, "--yes", "--format", "json")
    report: dict[str, Any] = json.loads(out)
    sums = report["totals"]
    left = [row for row in report["faults"] if row["why_not"] or not row["undone"]]
    assert (sums["watched"], sums["not_undone"], sums["not_well"]) == (sums["faults"], 0, 0), (left, told)
    assert code == (1 if sums["worse"] else 0)
    return report


def test_a_report_scores_each_fault_and_compares_with_the_last(
    robot: DrilledRobot, monkeypatch: Patch, capsys: Capture, tmp_path: Path
) -> None:
    wanted = ("--fault", "node-killed:mapping")
    told = check(robot, monkeypatch, capsys, *wanted)
    [row] = told["faults"]
    assert (row["promise"], row["outcome"], row["repaired"], row["undone"]) == ("told", "told", True, True)
    last = tmp_path / "last.json"
    last.write_text(json.dumps({**told, "faults": [{**row, "outcome": "missed"}]}))
    again = check(robot, monkeypatch, capsys, *wanted, "--against", str(last))
    assert again["against"]["better"] == ["node-killed:mapping: was missed, is told"]


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_every_fault_is_watched_and_undone(monkeypatch: Patch, capsys: Capture, tmp_path: Path) -> None:
    """All that can be planted on the demo's robot."""
    played = tedusar()
    config = {"observed": observed(played.model), "limits": {"attempts_per_hour": 200}}
    with drilled_robot(tmp_path, source=played.source, config=config) as demo:
        told = check(demo, monkeypatch, capsys, "--all")
        until(lambda: not demo.leftovers(), "everything is undone", 60.0)
    with capsys.disabled():
        print(told["totals"])


def test_worse_than_the_last_report_is_an_exit_code(
    robot: DrilledRobot, monkeypatch: Patch, capsys: Capture, tmp_path: Path
) -> None:
    last = tmp_path / "last.json"
    row = {"fault": "device-unplugged", "component": "lidar", "outcome": "told", "repaired": False}
    row |= {"needless": [], "detected_s": None, "repaired_s": None}
    last.write_text(json.dumps({"robomend_drill": 1, "faults": [row]}))
    wanted = ("--fault", "device-unplugged:lidar", "--detect-s", "1", "--against", str(last))
    said = "y\n\n\n"  # yes; pulled; plugged in
    code, out, told = drill(robot, monkeypatch, capsys, *wanted, said=said)
    assert "pull the data cable of lidar" in told
    assert "worse: device-unplugged:lidar: was told, is unseen" in out
    assert "look at the observer of ok(scan)" in out
    assert code == 1


def test_nothing_is_planted_without_a_yes(robot: DrilledRobot, monkeypatch: Patch, capsys: Capture) -> None:
    with robot.client as client:
        before = client.drills("r1")["items"]
        for said in ("n\n", ""):
            code, _, told = drill(robot, monkeypatch, capsys, "--all", said=said)
            assert "kill the process of mapping; undone by: start mapping" in told
            assert "logger" not in told
            assert code == 130
        assert client.drills("r1")["items"] == before


def test_what_is_misspelt_or_never_planted_is_refused_before_anything_is(
    robot: DrilledRobot, monkeypatch: Patch, capsys: Capture, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.json"
    bad.write_text("[]")
    for more, why in (
        (("--fault", "node-kiled:mapping"), "did you mean node-killed:mapping?"),
        (("--fault", "node-killed:logger"), "is never planted: logger is protected"),
        (("--all", "--against", str(bad)), "bad.json"),
        (("--all", "--plan"), "say one of"),
        ((), "say one of"),
    ):
        code, _, told = drill(robot, monkeypatch, capsys, *more, "--yes")
        assert (code, why in told) == (2, True), told


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL], ids=["ctrl-c", "kill -9"])
def test_ended_in_the_middle_the_command_leaves_nothing_planted(
    robot: DrilledRobot, how: signal.Signals
) -> None:
    robot.configure(policy="approve")  # a drill that nothing repairs is not over before the signal comes
    try:
        wanted = ("--fault", "node-frozen:mapping", "--yes", "--bound-s", "10")
        with robot.client as client:
            before = {one["id"] for one in client.drills("r1")["items"]}

            def new() -> list[dict[str, Any]]:
                return [one for one in client.drills("r1")["items"] if one["id"] not in before]

            process = subprocess.Popen(
                [sys.executable, "-m", "robomend", "drill", "r1", "--url", robot.url, *wanted],
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
            try:
                until(lambda: new() and new()[0]["state"] != "waiting", "the drill has begun", 60.0)
                os.kill(process.pid, how)
                code = process.wait(60)
            finally:
                process.kill()
                process.communicate()
            assert code in (AFTER_CTRL_C if how is signal.SIGINT else (-signal.SIGKILL,))
            ended = robot.ended(new()[0]["id"])
            assert ended["undone"]
            until(lambda: robot.halted() == [], "nothing is halted")
    finally:
        robot.configure(policy="auto")
