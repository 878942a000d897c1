"""`robomend import`: read what `robomend export` wrote into a new database."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from robomend.cli.export import database_url
from robomend.errors import InputError
from robomend_client.counts import counted


@click.command("import")
@click.argument("file", type=click.Path(path_type=Path), default="-")
@click.option("--database", help="URL of the database; default: the one that `robomend serve` would use.")
@click.option("--data", type=click.Path(path_type=Path), help="Folder of the SQLite database.")
@click.option("--config", type=click.Path(path_type=Path), help="YAML file of settings.")
def command(file: Path, database: str | None, data: Path | None, config: Path | None) -> None:
    """Read FILE (- for stdin) into an empty database: all of it, or nothing."""
    from robomend.store import portable
    from robomend.store.database import Database

    target = Database(database_url(database, data, config))
    if str(file) == "-":
        count = portable.load(target, sys.stdin)
    else:
        try:
            with file.open(encoding="utf-8") as lines:
                count = portable.load(target, lines)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{file}: {error}") from error
    click.echo(f"{counted(count, 'record')} into {target.shown}", err=True)
