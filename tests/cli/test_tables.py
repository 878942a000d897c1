"""Tables and sentences that fit the terminal, whatever is in them."""

from __future__ import annotations

import pytest

from robomend.cli.tables import at, show_table

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


def test_a_table_wraps_what_does_not_fit_and_loses_nothing(capsys: Capture) -> None:
    rows = [("r1", "x" * 200), ("[red]r2[/]", "\x1b[31mred")]
    show_table(("robot", "what"), rows)
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 80 and line == line.rstrip() for line in lines)
    assert "".join(lines[1:-1]).count("x") == 200
    assert lines[-1] == "[red]r2[/]  \\x1b[31mred"


def test_a_time_of_today_is_a_clock_and_others_have_their_day() -> None:
    noon = 1_764_072_000 * 10**9
    assert at(noon, now_ns=noon + 10**9) == "12:00:00"
    assert at(noon, now_ns=noon + 10**14) == "2025-11-25 12:00"
    assert at(None) == ""
