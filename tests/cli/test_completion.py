"""What shells complete; test_shells.py presses Tab in real ones."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

from robomend.cli.commands import cli
from robomend.resources import resource

TEDUSAR = str(resource("examples", "tedusar.yaml"))


def completed(*words: str) -> list[str]:
    """Return what the shell offers for the last word."""
    shell = ShellComplete(cli, {}, "robomend", "_ROBOMEND_COMPLETE")
    return [item.value for item in shell.get_completions(list(words[:-1]), words[-1])]


def test_commands_options_engines_and_planners_are_offered() -> None:
    assert completed("diag") == ["diagnose"]
    assert completed("model", "ch") == ["check"]
    assert "--planner" in completed("plan", "--pl")
    assert completed("diagnose", "--engine", "c") == ["cda_star"]
    assert completed("plan", "--planner", "") == ["dijkstra", "pyperplan", "asp", "fast-downward"]
    assert "sat" in completed("plan", "--engine", "")


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("diagnose", "--assume-healthy"),
        ("diagnose", "--assume-abnormal"),
        ("diagnose", "--expect-stopped"),
        ("plan", "--bad"),
        ("plan", "--protect"),
    ],
)
def test_components_of_the_model_that_was_given_are_offered(name: str, option: str) -> None:
    assert completed(name, TEDUSAR, option, "hok") == ["hokuyo", "hokuyo_node"]
    assert completed(name, option, "hok") == []  # no model yet


def test_a_model_that_cannot_be_read_offers_nothing(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text("robomend: [")
    assert completed("plan", str(tmp_path / "m.yaml"), "--bad", "") == []
    assert completed("plan", str(tmp_path / "none.yaml"), "--bad", "") == []


def test_a_model_is_completed_as_a_file() -> None:
    shell = ShellComplete(cli, {}, "robomend", "_ROBOMEND_COMPLETE")
    assert [item.type for item in shell.get_completions(["diagnose"], "exa")] == ["file"]
