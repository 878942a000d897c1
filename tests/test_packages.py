"""What is installed before tests: what those need that were asked for, and no more."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest
from tests import packages
from tests.packages import CHROMIUM, JAZZY, NEEDED, POSTGRESQL, ROS1, chromium, needed, run

ROOT = Path(__file__).resolve().parents[1]


def test_all_of_it_is_needed_where_no_path_is_named() -> None:
    assert needed([]) == needed(["-q", "--long", "-k", "a"]) == list(NEEDED)


@pytest.mark.parametrize(
    "path", ["tests/robots/test_configuration.py", "tests/cli::test_a", "tests/clients/test_bus.py"]
)
def test_a_recipes_own_test_waits_for_no_installation(monkeypatch: pytest.MonkeyPatch, path: str) -> None:
    monkeypatch.chdir(ROOT)
    assert needed(["-q", path]) == []


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


def test_the_folders_are_there() -> None:
    assert {place for places in NEEDED.values() for place in places if not (ROOT / place).is_dir()} == set()


@pytest.mark.parametrize(
    ("there", "taken"),
    [
        (
            {"chromium", "/usr/lib/chromium/chromium-headless-shell"},
            "/usr/lib/chromium/chromium-headless-shell",
        ),
        ({"google-chrome", "chrome-headless-shell"}, "chrome-headless-shell"),
        ({"google-chrome"}, "google-chrome"),
        (set(), None),
    ],
)
def test_of_the_browsers_that_are_there_the_headless_shell_is_taken(
    monkeypatch: pytest.MonkeyPatch, there: set[str], taken: str | None
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: name if name in there else None)
    assert chromium() == taken
