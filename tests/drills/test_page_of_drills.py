"""The commands and requests that docs/drill.md shows, on a robot of processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests import forked_programs
from tests.blocks import BLOCKS, Block
from tests.drills.drilled_robot import DrilledRobot, drilled_robot
from tests.test_blocks import commands_and_output, same
from tests.waiting import until

from robomend_demo.cast import observed, tedusar

SHOWN = "d-7k2m9x4q"

MINE = [block for block in BLOCKS if block.test == f"tests/drills/{Path(__file__).name}"]


def block(part: str) -> Block:
    [found] = [block for block in MINE if part in block.text]
    return found


WHOLE = block("last.json")
SCORE = block("faults watched")


def test_what_the_page_of_drills_shows_is_done(
    robot: DrilledRobot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", f"{forked_programs.write(tmp_path / 'programs')}:{os.environ['PATH']}")
    monkeypatch.setenv("ROBOMEND_URL", robot.url)
    monkeypatch.setenv("U", f"{robot.url}/api/v1")
    short = [block for block in MINE if block not in (WHOLE, SCORE)]
    assert {line.split()[0] for block in short for line in block.text.splitlines()} == {"robomend", "curl"}
    with robot.client as client:
        for block in short:
            robot.until_healthy()
            for line in block.text.splitlines():
                if "/robots/r1/drills" in line:  # one at a time
                    until(lambda: not robot.leftovers(), "the one before is undone", 200)
                    robot.until_healthy()
                asked = line.replace("curl ", "curl -sS --fail-with-body ")
                if SHOWN in line:  # the newest one
                    asked = asked.replace(SHOWN, client.drills("r1")["items"][0]["id"])
                done = shell(asked)
                while done.returncode and "would not be seen for itself" in done.stdout + done.stderr:
                    robot.until_healthy()  # a busy computer: something was not confirmed in time
                    done = shell(asked)
                assert done.returncode == 0, f"{block}: {line}\n{done.stdout}{done.stderr}"
        until(lambda: not robot.leftovers(), "everything is undone", 60)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_all_faults_are_drilled_twice_and_compared(
    robot: DrilledRobot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("ROBOMEND_URL", robot.url)
    monkeypatch.chdir(tmp_path)
    first, again = WHOLE.text.splitlines()
    for line in (first, again):
        robot.until_healthy()
        done = shell(line)
        assert done.returncode in (0, 1), done.stdout + done.stderr  # 1: something was worse than promised
        assert "0 not undone" in done.stdout + done.stderr or line == first
    report = json.loads((tmp_path / "last.json").read_text())
    assert report["totals"]["watched"] == report["totals"]["faults"] > 5


@pytest.mark.long
def test_the_score_of_two_faults_is_as_the_page_shows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("COLUMNS", "300")
    typed, output = commands_and_output(SCORE, SCORE.text)
    played = tedusar()
    with drilled_robot(tmp_path, source=played.source, config={"observed": observed(played.model)}) as demo:
        monkeypatch.setenv("ROBOMEND_URL", demo.url)
        demo.until_healthy()
        done = shell(typed.replace("drill tedusar", "drill r1") + " 2>&1")
        assert done.returncode == 0, done.stdout
        until(lambda: not demo.leftovers(), "everything is undone", 60)
    assert same(output, done.stdout), done.stdout


def shell(command: str) -> subprocess.CompletedProcess[str]:
    words = ["bash", "-euo", "pipefail", "-c", command]
    return subprocess.run(words, check=False, capture_output=True, text=True, timeout=300)
