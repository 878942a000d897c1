"""The help of every command, as it stands on a terminal of 80 columns."""

from __future__ import annotations

import re
from collections.abc import Iterator

import click
import pytest
from click.testing import CliRunner

from robomend.cli.commands import cli
from robomend_batch.commands import batch
from robomend_bench.main import command as bench
from robomend_board.main import main as board

WIDE = 80


def every(command: click.Command, *path: str) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Yield a command and those below it, with how each is typed."""
    yield path, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from every(below, *path, name)


PROGRAMS = {"robomend": cli, "robomend-batch": batch, "robomend-bench": bench, "robomend-board": board}
COMMANDS = [found for name, program in PROGRAMS.items() for found in every(program, name)]


@pytest.mark.parametrize(("path", "command"), COMMANDS, ids=[" ".join(path) for path, _ in COMMANDS])
def test_help_fits_80_columns_and_breaks_off_no_sentence(
    path: tuple[str, ...], command: click.Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDE))
    shown = CliRunner().invoke(command, ["--help"], prog_name=" ".join(path))
    assert shown.exit_code == 0, shown.output
    lines = shown.output.splitlines()
    assert [line for line in lines if len(line) > WIDE] == []
    assert [line for line in lines if re.search(r"[a-z]\.\.\.$", line)] == []


@pytest.mark.parametrize(("path", "command"), COMMANDS, ids=[" ".join(path) for path, _ in COMMANDS])
def test_every_option_that_is_shown_says_what_it_does(path: tuple[str, ...], command: click.Command) -> None:
    told = (click.Choice, click.IntRange)  # by what may stand there
    mute = [
        option.opts[0]
        for option in command.params
        if isinstance(option, click.Option) and not (option.hidden or option.help or option.show_default)
        if not isinstance(option.type, told)
    ]
    assert mute == [], path
