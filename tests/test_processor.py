"""The comparison of two trees' processor time: each with its own code, children counted."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.processor import SUITES, processor_s, ratios

import robomend_bench.suites

WORK = "import work"
BUSY = "import time\nwhile time.process_time() < {}: pass\n"


def tree(folder: Path, busy_s: float) -> Path:
    """Return a tree whose module `work` takes so much processor time in a process of its own."""
    (folder / "service").mkdir(parents=True)
    (folder / "service" / "busy.py").write_text(BUSY.format(busy_s))
    (folder / "service" / "work.py").write_text(
        "import subprocess, sys\nsubprocess.run([sys.executable, '-S', '-c', 'import busy'], check=True)\n"
    )
    return folder


def test_each_tree_runs_its_own_code_and_what_its_children_take_counts(tmp_path: Path) -> None:
    short, long = tree(tmp_path / "short", 0.0), tree(tmp_path / "long", 1.0)
    assert processor_s(long, ("-S", "-c", WORK)) >= 1.0  # at least: it is busy until then
    assert all(ratio > 1 for ratio in ratios(long, short, ("-S", "-c", WORK), 2))


def test_a_run_that_fails_is_no_figure(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="exit status 3"):
        processor_s(tmp_path, ("-S", "-c", "raise SystemExit(3)"))


def test_the_suites_are_there() -> None:
    (package,) = robomend_bench.suites.__path__
    there = {file.stem for file in Path(package).glob("*.py")} | {"service"}
    assert {arguments[2].replace("-", "_") for arguments in SUITES.values()} <= there
