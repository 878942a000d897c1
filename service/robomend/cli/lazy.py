"""A click group that imports a command only when it is run: `robomend --help` must not load a solver.

The table of a group holds one line per command, `name: ("module:attribute", "short help")`. A command whose
module is not in this installation is left out of the help, and says so when it is called. Other packages add
theirs by an entry point; as its short help is read from the command, its module must be light to import.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec

import click

Table = Mapping[str, tuple[str, str]]


class LazyGroup(click.Group):
    """A group that knows its commands by a table of import paths, and by a group of entry points."""

    def __init__(self, *args: object, table: Table, others: str | None = None, **options: object) -> None:
        super().__init__(*args, **options)  # type: ignore[arg-type]  # handed through to click as it came
        self.table = table
        self.others = others

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands of this installation, in the order of the table."""
        return [name for name in self.table if self._installed(name)] + sorted(self._others())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        path = self.table[cmd_name][0] if cmd_name in self.table else self._others().get(cmd_name)
        if path is None:
            return None
        if not self._installed(cmd_name):
            raise click.UsageError(f"`{cmd_name}` is not part of this installation of robomend")
        module, _, attribute = path.partition(":")
        command = getattr(import_module(module), attribute)
        if not isinstance(command, click.Command):
            raise TypeError(f"{path} is no click command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table, without importing a command of ours for its help."""
        rows = [(name, text) for name, (_, text) in self.table.items() if self._installed(name)]
        for name in sorted(self._others()):
            command = self.get_command(ctx, name)
            rows.append((name, "" if command is None else command.get_short_help_str(60)))
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def _installed(self, name: str) -> bool:
        return name not in self.table or find_spec(self.table[name][0].partition(":")[0]) is not None

    def _others(self) -> dict[str, str]:
        """Return name -> import path of the commands of other packages; ours cannot be taken over."""
        if self.others is None:
            return {}
        return {one.name: one.value for one in entry_points(group=self.others) if one.name not in self.table}
