"""`./dev test` runs what failed once more, by itself: what passes then is named, what fails then fails."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

MARKED = """
from pathlib import Path

def test_marked():
    mark = Path({mark!r})
    there = mark.exists()
    mark.touch()
    assert there and {good}

def test_good():
    pass
"""


@pytest.mark.parametrize(("good", "code", "said"), [(True, 0, "PASSED"), (False, 1, "FAILED")])
def test_what_failed_is_run_once_more(good: bool, code: int, said: str, tmp_path: Path) -> None:
    file = tmp_path / "test_marked.py"
    file.write_text(MARKED.format(mark=str(tmp_path / "mark"), good=good))
    own = [str(file), f"--rootdir={tmp_path}", "-c", os.devnull, "-o", f"cache_dir={tmp_path / 'cache'}"]
    done = subprocess.run(
        ["./dev", "test", *own],
        cwd=ROOT,
        env={**os.environ, "ROBOMEND_TEST_JOBS": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    _, again = done.stdout.split("1 failed, 1 passed")
    assert f"{said} " in again
    assert "test_marked" in again
    assert "test_good" not in again
