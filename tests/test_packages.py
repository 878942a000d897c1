"""What is installed before tests: what those need that were asked for, and no more."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from tests import packages
from tests.packages import CHROMIUM, JAZZY, NEEDED, POSTGRESQL, ROS1, needed, run

ROOT = Path(__file__).resolve().parents[1]


def test_all_of_it_is_needed_where_no_path_is_named() -> None:
    assert needed([]) == needed(["-q", "--long", "-k", "a"]) == list(NEEDED)


def test_a_folder_gets_what_is_needed_in_it_and_below_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert needed(["tests/web/test_pages.py", "tests/web"]) == [CHROMIUM]
    assert needed(["tests/store"]) == [POSTGRESQL]
    assert {ROS1, JAZZY} <= set(needed(["tests/clients/bridges"]))
    assert needed(["tests"]) == list(NEEDED)


def test_ctrl_c_during_an_installation_ends_it_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(arguments: Sequence[str]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(packages, "main", interrupted)
    with pytest.raises(SystemExit) as ended:
        run([])
    assert ended.value.code == 130
    assert capsys.readouterr().err.startswith("tests: interrupted")
