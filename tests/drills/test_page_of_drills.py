"""The commands and requests that docs/drill.md shows, on a robot of processes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.blocks import BLOCKS
from tests.drills.drilled_robot import DrilledRobot
from tests.waiting import until

SHOWN = "d-7k2m9x4q"

MINE = [block for block in BLOCKS if block.test == f"tests/drills/{Path(__file__).name}"]


@pytest.mark.timeout(600)
def test_what_the_page_of_drills_shows_is_done(robot: DrilledRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("ROBOMEND_URL", robot.url)
    monkeypatch.setenv("U", f"{robot.url}/api/v1")
    assert {line.split()[0] for block in MINE for line in block.text.splitlines()} == {"robomend", "curl"}
    with robot.client as client:
        for block in MINE:
            robot.until_healthy()
            for line in block.text.splitlines():
                if "/robots/r1/drills" in line:  # one at a time
                    until(lambda: not robot.leftovers(), "the one before is undone", 60)
                    robot.until_healthy()
                asked = line.replace("curl ", "curl -sS --fail-with-body ")
                if SHOWN in line:  # the newest one
                    asked = asked.replace(SHOWN, client.drills("r1")["items"][0]["id"])
                done = shell(asked)
                while done.returncode and "refused now: the robot is " in done.stdout + done.stderr:
                    robot.until_healthy()  # a busy computer: something was not confirmed in time
                    done = shell(asked)
                assert done.returncode == 0, f"{block}: {line}\n{done.stdout}{done.stderr}"
        until(lambda: not robot.leftovers(), "everything is undone", 60)


def shell(command: str) -> subprocess.CompletedProcess[str]:
    words = ["bash", "-euo", "pipefail", "-c", command]
    return subprocess.run(words, check=False, capture_output=True, text=True, timeout=300)
