"""Which parts of a benchmark are run: `--only speed,alarms`."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import click


def only(parts: Collection[str]) -> Callable[[Any], Any]:
    """Return the option `--only`: the parts that it names, all if it names none; others are refused."""

    def named(context: click.Context, parameter: click.Parameter, value: str) -> tuple[str, ...]:
        names = tuple(filter(None, value.split(","))) or tuple(parts)
        for name in names:
            if name not in parts:
                raise click.BadParameter(f"{name!r} is none of {', '.join(parts)}")
        return names

    told = f"Parts, comma-separated: {', '.join(parts)}."
    return click.option("--only", "parts", callback=named, default="", help=told)
