"""The command robomend-bench isolability."""

from __future__ import annotations

import json

import pytest
from tests.robomend_bench.test_main import run


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
