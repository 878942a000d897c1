"""The files of docs/deploy that need no registry and no root: systemd's own checker reads the units."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

DEPLOY = Path(__file__).resolve().parents[1] / "docs" / "deploy"
UNITS = sorted(DEPLOY.glob("*.service"))


def verified(unit: Path, folder: Path) -> str:
    """Return what `systemd-analyze verify` says of a unit whose program is there."""
    program = folder / "program"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    copy = folder / unit.name
    copy.write_text(re.sub(r"^(ExecStart=)\S+", rf"\1{program}", unit.read_text(), flags=re.M))
    checker = shutil.which("systemd-analyze")
    if checker is None:
        pytest.skip("there is no systemd here, which has the checker")
    done = subprocess.run([checker, "verify", str(copy)], capture_output=True, text=True, timeout=60)
    # Units of the machine that are read besides are no concern of ours.
    return "\n".join(line for line in (done.stdout + done.stderr).splitlines() if unit.name in line)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_systemd_finds_nothing_amiss_in_a_unit(unit: Path, tmp_path: Path) -> None:
    assert verified(unit, tmp_path) == ""


def test_systemd_would_find_a_key_that_it_does_not_know(tmp_path: Path) -> None:
    unit = tmp_path / "wrong.service"
    unit.write_text(UNITS[0].read_text().replace("RestartSec=1", "RestartSecs=1"))
    folder = tmp_path / "copy"
    folder.mkdir()
    assert "RestartSecs" in verified(unit, folder)
