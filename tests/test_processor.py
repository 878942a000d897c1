"""The comparison of two trees' processor time: each with its own code, children counted."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests import processor
from tests.processor import SUITES, Kept, main, processor_s, ratios

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
    short, long = tree(tmp_path / "short", 0.0), tree(tmp_path / "long", 0.4)
    assert processor_s(long, ("-S", "-c", WORK)) >= 0.4  # at least: it is busy until then
    assert all(ratio > 1 for ratio in ratios(long, short, ("-S", "-c", WORK), range(2)))


def test_pairs_that_were_run_are_not_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run: list[int] = []

    def made_up(ours: Path, other: Path, arguments: object, pairs: range) -> Iterator[float]:
        for pair in pairs:
            run.append(pair)
            if len(run) == 3:
                raise KeyboardInterrupt
            yield 2.0

    monkeypatch.setattr(processor, "ratios", made_up)
    asked = ["HEAD", "--pairs", "4", "--only", "plans", "--keep", str(tmp_path / "kept")]
    Kept(tmp_path / "kept", "another").add("plans", 9.0)
    with pytest.raises(KeyboardInterrupt):
        main(asked)
    assert main(asked) == 0
    assert run == [0, 1, 2, 2, 3]
    assert capsys.readouterr().out == "plans: 2.000 of HEAD (2.000 2.000 2.000 2.000)\n"


def test_a_run_that_fails_is_no_figure(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="exit status 3"):
        processor_s(tmp_path, ("-S", "-c", "raise SystemExit(3)"))


def test_the_suites_are_there() -> None:
    (package,) = robomend_bench.suites.__path__
    there = {file.stem for file in Path(package).glob("*.py")} | {"service"}
    assert {arguments[2].replace("-", "_") for arguments in SUITES.values()} <= there
