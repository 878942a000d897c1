"""`robomend init`: files to start from, which our own readers took before they were written."""

from __future__ import annotations

import click

from robomend.cli.commands import LazyGroup, Table

COMMANDS: Table = {
    "model": ("robomend.cli.init.model:command", "A commented model, to be edited."),
    "robot": ("robomend.cli.init.robot:command", "Model, agent's file and configuration of a robot."),
    "observer": ("robomend.cli.init.observer:command", "An observer of your own, with its test."),
    "action": ("robomend.cli.init.action:command", "An action of your own in PDDL, with its test."),
}


class InitGroup(LazyGroup):
    """`init`, `init my_robot.yaml` and `init --name x` are `init model` with the same."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the command in front where a file or an option of `init model` stands there."""
        first = args[0] if args else ""
        if not args or first.endswith((".yaml", ".yml")) or first in ("--force", "--name"):
            args = ["model", *args]
        return super().parse_args(ctx, args)


@click.group("init", cls=InitGroup, table=COMMANDS)
def command() -> None:
    """Write files to start from; none that is there is overwritten.

    `robomend init FILE.yaml` is `robomend init model FILE.yaml`.
    """
