"""Files that are written all or not at all, and never over one that is there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import click

from robomend.errors import InputError


def write_new(folder: Path, texts: Mapping[str, str]) -> None:
    """Write each text to its name in a folder, and say so; a folder that is not there is made.

    Raises:
        InputError: one of the files is there already, or cannot be written; none is left half written.
    """
    there = [str(folder / name) for name in texts if (folder / name).exists()]
    if there:
        raise InputError(
            f"{', '.join(there)}: there already, and nothing is overwritten; --folder says where else"
        )
    written: list[Path] = []
    try:
        for name, text in texts.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("x", encoding="utf-8") as file:
                written.append(path)
                file.write(text)
    except OSError as error:
        for path in written:
            path.unlink(missing_ok=True)
        raise InputError(f"{error.filename} cannot be written: {error.strerror}") from error
    for path in written:
        click.echo(f"wrote {path}", err=True)
