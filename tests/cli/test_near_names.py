"""What was mistyped is named with what was probably meant: commands, options, files, engines, components."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomend.cli.commands import run
from robomend.resources import resource

TEDUSAR = str(resource("examples", "tedusar.yaml"))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in: a robot, its domain, and another model one folder down."""
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "carrier.yaml").write_text("robomend: 1\n")
    (tmp_path / "my_robot.yaml").write_text("robomend: 1\n")
    (tmp_path / "settings").write_text("prot: 8600\n")
    (tmp_path / "actions.pddl").write_text("(define (domain robot-repair))")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["diagnos"], "no command is named 'diagnos'; did you mean 'diagnose'?"),
        (["model", "chek"], "no command is named 'chek'; did you mean 'check'?"),
        (["init", "agent"], "no command is named 'agent': there are model, robot, observer, action\n"),
        (["frobnicate"], "no command is named 'frobnicate'\n"),
        (["plan", "x", "--plnner", "asp"], "no option is named '--plnner'; did you mean '--planner'?"),
        (["diagnose", "my_robot.yml"], "No such file or directory; did you mean my_robot.yaml?"),
        (["diagnose", "carrier.yaml"], "No such file or directory; did you mean robots/carrier.yaml?"),
        (["diagnose", "two.wcnf"], "two.wcnf: cannot be read: No such file or directory\n"),
        (["plan", TEDUSAR, "--domain", "action.pddl"], "does not exist; did you mean actions.pddl?"),
        (["diagnose", TEDUSAR, "--observations", "action.pddl"], "directory; did you mean actions.pddl?"),
        (["config", "--config", "my_robot.yml"], "does not exist; did you mean my_robot.yaml?"),
        (["config", "--config", "nofiles.yaml"], "'nofiles.yaml' does not exist\n"),  # alike by its ending
        (["config", "--config", "settings"], "there is no setting 'prot'; did you mean 'port'?"),
        (["diagnose", TEDUSAR, "--engine", "hsdag"], "did you mean 'hs_dag'?"),
        (["plan", TEDUSAR, "--planner", "piperplan"], "did you mean 'pyperplan'?"),
        (["plan", TEDUSAR, "--bad", "rvis"], "did you mean 'rviz'?"),
        (["plan", TEDUSAR, "--expect-stopped", "rvis"], "did you mean 'rviz'?"),
        (["diagnose", TEDUSAR, "--expect-stopped", "rvis"], "did you mean 'rviz'?"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_what_was_meant_is_named(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.out == ""


def test_a_name_alone_asks_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["model"]):
        assert run(words) == 2
        said = capsys.readouterr().err
        assert said.count("Usage:") == 1
        assert "error:" not in said
        assert "Commands:" in said


def test_an_example_that_was_shipped_is_found_from_anywhere(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["diagnose", "tedusar.yaml"]) == 2
    assert f"; did you mean {TEDUSAR}?" in capsys.readouterr().err
    (folder / "tedusar.yml").write_text("")
    assert run(["diagnose", "tedusar.yaml"]) == 2
    assert "; did you mean tedusar.yml?" in capsys.readouterr().err
