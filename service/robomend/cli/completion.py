"""What shells complete besides commands, options and files: engines, planners, components of the model given.

Whoever completes only looks: a model that cannot be read offers nothing, and no type here refuses a value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from robomend.errors import RobomendError

LARGEST_MODEL = 1 << 20
"""Bytes of a model that is read for its names, as somebody waits for them."""

OFFERED = 200


class PartName(click.ParamType[str]):
    """The name of an engine, a planner, …: a part that a registry knows."""

    def __init__(self, what: str, names: Callable[[], Sequence[str]]) -> None:
        self.name = what
        self.names = names

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return those of this installation, others' as well."""
        return _beginning(incomplete, self.names())


class ComponentName(click.ParamType[str]):
    """A component of the model that the command was given."""

    name = "component"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the components of the model that stands in the command line already."""
        # While an option still lacks its value, click leaves the arguments unassigned.
        path = ctx.params.get("model") or next(iter(ctx.args), None)
        if path is None:
            return []
        try:
            if Path(path).stat().st_size > LARGEST_MODEL:
                return []
            from robomend.model.loading import load_model

            return _beginning(incomplete, load_model(path).cnf.components)
        except (RobomendError, OSError, ValueError):
            return []


def components_option(flag: str, said: str) -> Callable[[Any], Any]:
    """Return the option that takes components of the model, one at a time; `said`: its help."""
    return click.option(flag, type=ComponentName(), multiple=True, metavar="COMPONENT", help=said)


def _beginning(incomplete: str, names: Sequence[str]) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(incomplete)][:OFFERED]
