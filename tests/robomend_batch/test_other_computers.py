"""The lines of docs/batch.md for several computers, on two: this one, and a network namespace."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.blocks import BLOCKS, ROOT
from tests.other_computer import other_computer
from tests.robomend_batch.recordings import steady, write
from tests.robomend_batch.running import tree
from tests.robomend_batch.test_cluster import process
from tests.waiting import until

from robomend.cli.commands import run

LOGS = "/mnt/night"


def test_the_lines_for_several_computers_leave_what_one_leaves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, long: bool
) -> None:
    if not long:
        pytest.skip("a dozen processes start, which takes half a minute: --long")
    [block] = [block for block in BLOCKS if block.test == f"tests/robomend_batch/{Path(__file__).name}"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    assert run(["init", "my_robot.yaml"]) == 0
    (tmp_path / "agent.yaml").write_text((ROOT / "examples" / "agent.yaml").read_text())
    (tmp_path / "night").mkdir()
    for name in ("a", "b"):
        write(tmp_path / "night" / f"{name}.bag", [*steady("odom", 10.0, 20.0), *steady("scan", 10.0, 20.0)])
    with other_computer() as other, ExitStack() as stack:
        typed = block.text.replace("HOST", other.there).replace(LOGS, str(tmp_path / "night"))
        scheduler, worker, diagnosed = (shlex.split(line, comments=True) for line in typed.splitlines())
        for line in ([*other.inside, *scheduler], [*other.inside, *worker], worker):
            stack.enter_context(process(line, tmp_path))
        said = tmp_path / "said.txt"
        until(lambda: said.read_text().count("Starting established connection to") >= 8 + 8, "8 workers", 300)
        done = subprocess.run(diagnosed, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr + said.read_text()[-2000:]
        cluster = (diagnosed.index("--scheduler"), diagnosed.index("--scheduler") + 2)
        alone = [*diagnosed[: cluster[0]], *diagnosed[cluster[1] :], "--workers", "0"]
        alone[alone.index("-o") + 1] = "alone"
        assert subprocess.run(alone, capture_output=True, timeout=300).returncode == 0
    assert tree(tmp_path / "out") == tree(tmp_path / "alone")
