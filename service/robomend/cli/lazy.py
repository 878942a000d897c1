"""A click group that imports a command only when it is run: `robomend --help` must not load a solver.

The table of a group holds one line per command, `name: ("module:attribute", "short help")`. A command whose
module is not in this installation is left out of the help, and says so when it is called. Other packages add
theirs by an entry point; as its short help is read from the command, its module must be light to import.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec

import click

from robomend_client.registry import Registry

Table = Mapping[str, tuple[str, str]]


class LazyGroup(click.Group):
    """A group that knows its commands by a table of import paths, and by a group of entry points."""

    def __init__(self, *args: object, table: Table, others: str | None = None, **options: object) -> None:
        super().__init__(*args, **options)  # type: ignore[arg-type]  # handed through to click as it came
        self.table = table
        self.registry = Registry[object](
            "command", others, {name: path for name, (path, _) in table.items()}, broken=click.ClickException
        )

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands of this installation: ours in the order of the table, then the others'."""
        return [name for name in self.registry.names() if self._installed(name)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        if not self._installed(cmd_name):
            raise click.UsageError(f"`{cmd_name}` is not part of this installation of robomend")
        try:
            command = self.registry.load(cmd_name)
        except LookupError:
            return None
        if not isinstance(command, click.Command):
            raise TypeError(f"{cmd_name} is no click command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table, without importing a command of ours for its help."""
        rows = []
        for name in self.list_commands(ctx):
            rows.append((name, self.table[name][1] if name in self.table else self._short_help(ctx, name)))
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def _short_help(self, ctx: click.Context, name: str) -> str:
        """Return what another package's command says of itself, which may be that it is broken."""
        try:
            command = self.get_command(ctx, name)
        except click.ClickException as error:
            return error.message
        return "" if command is None else command.get_short_help_str(60)

    def _installed(self, name: str) -> bool:
        path = self.registry.built_in.get(name)
        return path is None or find_spec(path.partition(":")[0]) is not None
