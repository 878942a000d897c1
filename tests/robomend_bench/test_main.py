"""The command robomend-bench."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from robomend_bench.main import main


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["robomend-bench", *arguments])
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_a_suite_is_run_written_and_compared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    only = ("--only", "c17", "--instances", "2", "--repeats", "1")
    assert run(monkeypatch, "iscas85", *only, "--out", str(tmp_path)) == 0
    assert "| c17 | 6 | sat | 2/2 |" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {
        "iscas85-first.json",
        "iscas85-first.md",
        "iscas85-first-cactus.svg",
    }
    written = str(tmp_path / "iscas85-first.json")
    assert run(monkeypatch, "--compare", written, written) == 0
    assert "1.00×" in capsys.readouterr().out


def test_json_goes_to_stdout(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("robots-v1", "--only", "5", "--instances", "1", "--repeats", "1", "--format", "json")
    assert run(monkeypatch, *arguments) == 0
    tree = json.loads(capsys.readouterr().out)
    assert (tree["suite"], tree["mode"], tree["seed"]) == ("robots-v1", "explained", 1)


def test_questions_of_any_minimum_cardinality_can_be_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    few = ("--only", "c17", "--engines", "sat", "--instances", "2", "--repeats", "1", "--format", "json")
    assert run(monkeypatch, "iscas85", *few, "--size", "any", "--faults", "2") == 0
    asked = [sample["question"] for sample in json.loads(capsys.readouterr().out)["samples"]]
    assert asked == ["000-2f", "001-2f"]


def test_what_is_there_is_listed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "--list") == 0
    listed = capsys.readouterr().out
    for word in ("iscas85", "robots-v1", "multi-observation", "sat", "hs_dag", "rc2-stratified", "first"):
        assert word in listed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name a suite"),
        (("nothing",), "no suite is named 'nothing'"),
        (("iscas85", "--mode", "best"), "has no mode 'best'"),
        (("iscas85", "--only", "c18"), "choose from c17"),
        (("robots-v1", "--only", "2"), "numbers of components"),
        (("iscas85", "--faults", "0"), "range from 1 up"),
        (("iscas85", "--faults", "3-1"), "range from 1 up"),
        (("iscas85", "--faults", "x"), "a number or a range"),
        (("iscas85", "--timeout", "0"), "0"),
        (("iscas85", "--instances", "0"), "0"),
        (("robots", "--only", "speed,wings"), "'wings' is none of speed"),
        (("batch", "--only", "wings"), "'wings' is none of literals"),
        (("service", "--only", "fleets"), "fleets"),
    ],
)
def test_bad_input_exits_with_2_and_says_what_is_allowed(
    arguments: tuple[str, ...],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(monkeypatch, *arguments) == 2
    assert message in capsys.readouterr().err


def test_a_file_that_is_no_result_exits_with_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    other = tmp_path / "other.json"
    other.write_text("{}")
    assert run(monkeypatch, "--compare", str(other), str(other)) == 2
    assert "not a result of robomend-bench" in capsys.readouterr().err


def test_generated_robots_are_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("isolability", "--only", "40", "--repeats", "1")
    assert run(monkeypatch, *arguments, "--format", "json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["at hand"] for row in rows] == ["all", "robots-v1", "few topics"]
    assert rows[0]["groups"] < rows[2]["groups"]
    assert all(row["complete"] for row in rows)
    assert run(monkeypatch, *arguments) == 0
    assert "| 40 | all |" in capsys.readouterr().out
