"""A click group that imports a command only when it is run: `robomend --help` must not load a solver.

The table of a group holds one line per command, `name: ("module:attribute", "short help")`. A command whose
module is not in this installation is left out of the help, and says so when it is called.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec

import click

Table = Mapping[str, tuple[str, str]]


class LazyGroup(click.Group):
    """A group that knows its commands by a table of import paths."""

    def __init__(self, *args: object, table: Table, **options: object) -> None:
        super().__init__(*args, **options)  # type: ignore[arg-type]  # handed through to click as it came
        self.table = table

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands of this installation, in the order of the table."""
        return [name for name in self.table if self._installed(name)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        if cmd_name not in self.table:
            return None
        if not self._installed(cmd_name):
            raise click.UsageError(f"`{cmd_name}` is not part of this installation of robomend")
        module, _, attribute = self.table[cmd_name][0].partition(":")
        command = getattr(import_module(module), attribute)
        if not isinstance(command, click.Command):
            raise TypeError(f"{module}:{attribute} is no click command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table, without importing a command for its help."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, self.table[name][1]) for name in self.list_commands(ctx)])

    def _installed(self, name: str) -> bool:
        return find_spec(self.table[name][0].partition(":")[0]) is not None
