"""The command robomend-bench mutated."""

from __future__ import annotations

import json
import random
import shlex
import sys
from pathlib import Path

import pytest
from tests.robomend_bench.test_main import run

from robomend.diagnosis.result import Options
from robomend.diagnosis.snapshots import SnapshotEngine
from robomend.diagnosis.wcnf import read_wcnf
from robomend.model.loading import load_text
from robomend_bench.generator import observe_mutated, read_circuit
from robomend_bench.mutated import as_wcnf
from robomend_bench.suite import DATA

ONE = ("mutated", "--only", "c17", "--instances", "1", "--timeout", "60")


def measured(capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    (row,) = json.loads(capsys.readouterr().out)
    return dict(row)


def prints(*diagnoses: str) -> tuple[str, str]:
    """Return the option for a solver that lists these."""
    lines = "".join(f"c D: {diagnosis} 0\n" for diagnosis in diagnoses)
    return "--against", shlex.join([sys.executable, "-c", f"print({lines!r})", "{file}"])


def test_the_file_that_is_written_means_what_was_seen(tmp_path: Path) -> None:
    text = (DATA / "iscas85" / "c17.bench").read_text()
    cnf = load_text(text, name="c17", format="bench").cnf
    seen = observe_mutated(read_circuit(text), 2, 8, random.Random(3))
    assert seen == observe_mutated(read_circuit(text), 2, 8, random.Random(3))
    assert seen != observe_mutated(read_circuit(text), 2, 8, random.Random(4))
    path = tmp_path / "c17.wcnf"
    path.write_text(as_wcnf(cnf, seen))
    read = read_wcnf(path)
    every = Options(limit=None)
    written = {
        diagnosis.bad for diagnosis in SnapshotEngine(read.cnf).diagnose(read.snapshots, every).diagnoses
    }
    meant = SnapshotEngine(cnf).diagnose(seen, every).diagnoses
    assert {tuple(str(cnf.health[name]) for name in one.bad) for one in meant} == written
    assert () not in written


def test_whoever_lists_no_more_of_any_size_is_not_ahead(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(monkeypatch, *ONE, "--format", "json", "--out", str(tmp_path)) == 0
    row = measured(capsys)
    assert (row["complete"], row["theirs"], row["behind"]) == (True, None, False)
    assert isinstance(row["ours"], dict)
    assert [path.name for path in tmp_path.iterdir()] == ["c17-0.wcnf"]
    read = read_wcnf(tmp_path / "c17-0.wcnf")
    found = SnapshotEngine(read.cnf).diagnose(read.snapshots, Options(limit=None, max_size=3)).diagnoses
    assert sum(row["ours"].values()) == len(found) > 0
    same = [" ".join(diagnosis.bad) for diagnosis in found]
    assert run(monkeypatch, *ONE, *prints(*same, same[0]), "--format", "json") == 0
    row = measured(capsys)
    assert (row["theirs"], row["behind"]) == (row["ours"], False)
    assert run(monkeypatch, *ONE, *prints(*same)) == 0
    assert "on 1 of 1 instance." in capsys.readouterr().out


def test_a_solver_that_does_not_end_is_ended_and_what_it_printed_counts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    loops = "print('c D: 1 2 3 4 0', flush=True)\nwhile True: pass"
    against = ("--against", shlex.join([sys.executable, "-c", loops, "{file}"]))
    arguments = ("mutated", "--only", "c17", "--instances", "1", "--timeout", "1", "--max-size", "4")
    run(monkeypatch, *arguments, *against, "--format", "json")
    assert measured(capsys)["theirs"] == {"4": 1}


def test_bad_input_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, "mutated", "--only", "c18") == 2
    assert run(monkeypatch, *ONE, "--against", "no-such-solver") == 2
    assert run(monkeypatch, *ONE, "--against", "no-such-solver {file}") == 2
