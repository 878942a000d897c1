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
def test_help_fits_80_columns_breaks_off_no_sentence_and_explains_every_option(
    path: tuple[str, ...], command: click.Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDE))
    shown = CliRunner().invoke(command, ["--help"], prog_name=" ".join(path))
    assert shown.exit_code == 0, shown.output
    lines = shown.output.splitlines()
    assert [line for line in lines if len(line) > WIDE] == []
    assert [line for line in lines if re.search(r"[a-z]\.\.\.$", line)] == []
    told = (click.Choice, click.IntRange)  # by what may stand there
    options = [option for option in command.params if isinstance(option, click.Option) and not option.hidden]
    mute = [
        one.opts[0] for one in options if not (one.help or one.show_default or isinstance(one.type, told))
    ]
    assert mute == []
