"""`robomend export`: everything that is stored, as NDJSON, or a copy of the SQLite database in use."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import click

from robomend.errors import InputError, StateConflict, StoreError

FORMATS = ("ndjson", "sqlite")


@click.command("export")
@click.option("--database", help="URL of the database; default: the one that `robomend serve` would use.")
@click.option("--data", type=click.Path(path_type=Path), help="Folder of the SQLite database.")
@click.option("--config", type=click.Path(path_type=Path), help="YAML file of settings.")
@click.option("--output", "-o", type=click.Path(path_type=Path), help="A new file, instead of stdout.")
@click.option(
    "--format", "format_", type=click.Choice(["ndjson", "sqlite"]), default="ndjson", show_default=True
)
@click.option("--with-secrets", is_flag=True, help="Of webhooks and other executors, as they are, in ndjson.")
def command(
    database: str | None,
    data: Path | None,
    config: Path | None,
    output: Path | None,
    format_: str,
    with_secrets: bool,
) -> None:
    """Write everything that is stored, while the service runs or not.

    ndjson can be read by `robomend import` into either kind of database; sqlite is a copy of a SQLite
    database, ready to be used in its place. Both hold hashes of API keys: keep them as safe as the database.
    Secrets of executors are covered in ndjson, and have to be put in again after an import, unless you ask
    for them; a copy has them all.
    """
    from robomend.robots.configuration import covered
    from robomend.store import portable
    from robomend.store.database import Database

    source = Database(database_url(database, data, config))
    if format_ == "sqlite":
        if output is None:
            raise InputError("--format sqlite needs --output FILE")
        portable.backup(source, output)
        return
    lines = portable.export(source) if with_secrets else portable.export(source, covered)
    if output is None:
        sys.stdout.writelines(lines)
        return
    with _new_file(output) as file:
        file.writelines(lines)


def database_url(database: str | None, data: Path | None, config: Path | None) -> str:
    """Return the URL that the service would use with these settings."""
    from robomend import settings

    given, _ = settings.load({"database": database, "data": data}, os.environ, config)
    return given.database_url


@contextmanager
def _new_file(path: Path) -> Iterator[IO[str]]:
    """A file that only its owner can read and that appears under its name when it is whole and on disk."""
    if path.exists():
        raise StateConflict(f"{path} exists; name a new file")
    partial = path.with_name(f"{path.name}.partial")
    try:
        descriptor = os.open(partial, os.O_CREAT | os.O_WRONLY | os.O_TRUNC | os.O_CLOEXEC, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.rename(path)
    except OSError as error:
        raise StoreError(f"{path}: {error.strerror}") from error
    finally:
        partial.unlink(missing_ok=True)
