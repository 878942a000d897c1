"""A run in pieces: what is in the file is not played again, and what no run can have written is refused."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from robomend_bench.faults.command import Kept, OtherTerms
from robomend_bench.faults.scoring import Score
from robomend_bench.main import main

TERMS = {"observers": "fast", "agent": "service", "load": 0}
WELL = Score(
    "base/off/1.1", "off", "faults", repairable=True, repaired=True, repaired_s=1.5, parts={"acts": 0.3}
)


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["robomend-bench", "faults", *arguments])
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (
            json.dumps({"terms": {**TERMS, "observers": "published"}}),
            "observers: 'published' there, 'fast' now",
        ),
        (json.dumps({"terms": {**TERMS, "boots": True}}), "boots: True there, None now"),
        ("a list of purchases", "is no file of scores"),
        ("[1]", "is no file of scores"),
        (json.dumps({"terms": TERMS}) + "\n{}\n" + json.dumps(WELL.as_json()), "line 2: no score"),
    ],
)
def test_what_is_of_another_kind_is_refused(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "scores"
    path.write_text(text)
    with pytest.raises(OtherTerms, match=why):
        Kept(path, TERMS)
    assert path.read_text() == text


def test_pieces_come_to_the_same_as_one_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    few = ("--robots", "base", "--observers", "fast", "--agent", "perfect", "--classes", "off,dead-node,boot")
    one = (*few, "--trials", "4", "--stretches", "1", "--format", "json")
    kept = ("--keep", str(tmp_path / "scores"))

    def told(*arguments: str) -> dict[str, Any]:
        assert run(monkeypatch, *arguments) == 0
        found: dict[str, Any] = json.loads(capsys.readouterr().out)
        return found

    whole = told(*one)
    nothing = told(*one, *kept, "--minutes", "1e-9")
    assert (nothing["scores"], nothing["not_begun"]) == ([], 5)
    assert len(told(*few, *kept, "--trials", "2", "--stretches", "0", "--format", "json")["scores"]) == 2
    pieces = told(*one, *kept)
    assert (pieces["scores"], pieces["figures"]) == (whole["scores"], whole["figures"])
    lines = (tmp_path / "scores").read_text()
    assert told(*one, *kept)["scores"] == whole["scores"]
    assert (tmp_path / "scores").read_text() == lines  # nothing was played
