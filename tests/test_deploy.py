"""What of docs/deploy needs no registry and no root: systemd's own checker reads the units, pipx installs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.blocks import BLOCKS, ROOT

DEPLOY = Path(__file__).resolve().parents[1] / "docs" / "deploy"
UNITS = sorted(DEPLOY.glob("*.service"))


def verified(unit: Path, folder: Path) -> str:
    """Return what `systemd-analyze verify` says of a unit whose program is there."""
    program = folder / "program"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    copy = folder / unit.name.replace("@.", "@8601.")  # of a template, an instance
    copy.write_text(re.sub(r"^(ExecStart=)\S+", rf"\1{program}", unit.read_text(), flags=re.M))
    checker = shutil.which("systemd-analyze")
    if checker is None:
        pytest.skip("there is no systemd here, which has the checker")
    done = subprocess.run([checker, "verify", str(copy)], capture_output=True, text=True, timeout=60)
    # Units of the machine that are read besides are no concern of ours.
    return "\n".join(line for line in (done.stdout + done.stderr).splitlines() if copy.name in line)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_systemd_finds_nothing_amiss_in_a_unit(unit: Path, tmp_path: Path) -> None:
    assert verified(unit, tmp_path) == ""


@pytest.mark.timeout(1500)
def test_the_lines_for_pipx_put_every_command_on_the_path(tmp_path: Path, long: bool) -> None:
    if not long:
        pytest.skip("it installs everything anew, which takes minutes: --long")
    [block] = [block for block in BLOCKS if "pipx install" in block.text]
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "tools")], check=True, timeout=120)
    tools = tmp_path / "tools" / "bin"
    subprocess.run([str(tools / "pip"), "install", "--quiet", "pipx"], check=True, timeout=300)
    left = shutil.ignore_patterns(".*", "*.egg-info", "__pycache__", "report", "site", "dist", "build")
    shutil.copytree(ROOT, tmp_path / "src", ignore=left)
    apps = tmp_path / "apps"
    environment = {
        **os.environ,
        "PATH": f"{tools}:{os.environ['PATH']}",
        "PIPX_HOME": str(tmp_path / "home"),
        "PIPX_BIN_DIR": str(apps),
    }
    command = ["bash", "-euo", "pipefail", "-c", block.text]
    done = subprocess.run(
        command, cwd=tmp_path / "src", env=environment, capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for name in ("robomend", "robomend-agent", "robomend-batch", "robomend-bench", "robomend-board"):
        asked = subprocess.run([str(apps / name), "--help"], capture_output=True, timeout=100)
        assert asked.returncode == 0, name
