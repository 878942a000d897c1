"""Which parts of a benchmark are run: `--only speed,alarms`."""

from __future__ import annotations

from collections.abc import Collection

import click


def wanted(only: str, parts: Collection[str]) -> tuple[str, ...]:
    """Return the parts that `--only` names, all if it names none; refused before the first is run."""
    names = tuple(filter(None, only.split(","))) or tuple(parts)
    for name in names:
        if name not in parts:
            raise click.BadParameter(f"{name!r} is none of {', '.join(parts)}", param_hint="--only")
    return names
