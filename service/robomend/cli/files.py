"""Files that a command is given, and the one that was meant where there is none of that name."""

from __future__ import annotations

from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import click

from robomend.resources import resource
from robomend_client.near import nearest

LOOKED_AT = 1000
"""Entries of a folder that are compared or looked into."""


class ExistingFile(click.Path):
    """A parameter that is a file to be read."""

    def __init__(self) -> None:
        super().__init__(exists=True, dir_okay=False, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; the error about a missing file names the one that was probably meant."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            self.fail(error.message.removesuffix(".") + near_file(str(value)), param, ctx)


def near_file(path: str) -> str:
    """Return `; did you mean examples/tedusar.yaml?` for a file that is not there, or nothing."""
    meant = None if Path(path).exists() else _nearest(Path(path)) or _shipped(Path(path))
    return "" if meant is None else f"; did you mean {meant}?"


def _nearest(path: Path) -> Path | None:
    """Return a file of this name one folder further down, or one of a name like it."""
    folder = path.parent
    if not folder.is_dir():
        near = None if folder == path else _nearest(folder)
        return None if near is None else _nearest_in(near, path.name)
    below = (entry / path.name for entry in _entries(folder))
    return next((file for file in below if file.is_file()), None) or _nearest_in(folder, path.name)


def _nearest_in(folder: Path, name: str) -> Path | None:
    near = nearest(name, [entry.name for entry in _entries(folder)])
    if near is None or nearest(Path(name).stem, [Path(near).stem]) is None:  # alike by their ending alone
        return None
    return folder / near


def _entries(folder: Path) -> list[Path]:
    try:
        return [entry for entry in islice(folder.iterdir(), LOOKED_AT) if not entry.name.startswith(".")]
    except OSError:
        return []


def _shipped(path: Path) -> Path | None:
    """Return an example that came with robomend."""
    for kind in ("examples", "examples/actions"):
        with suppress(FileNotFoundError):
            return resource(kind, path.name)
    return None
