"""`robomend config`: the settings in force, each with where its value came from; and the options by which
every command on the service's settings is told them.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.files import ExistingFile

if TYPE_CHECKING:
    from robomend.settings import Settings

CONFIG_VARIABLE = "ROBOMEND_CONFIG"


def settings_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --config, --data and --database to a command."""
    for option in (
        click.option("--database", help="URL of a database, instead of SQLite in the data folder."),
        click.option("--data", type=click.Path(path_type=Path), help="Folder of the SQLite database."),
        click.option(
            "--config",
            "config_file",
            type=ExistingFile(),
            envvar=CONFIG_VARIABLE,
            help=f"YAML file of settings; also by {CONFIG_VARIABLE}.",
        ),
    ):
        command = option(command)
    return command


def read_settings(config_file: Path | None, **flags: Any) -> tuple[Settings, dict[str, str]]:
    """Return the settings, flags over environment over file, and where each came from."""
    from robomend.settings import load

    return load(flags, os.environ, config_file)


@click.command("config")
@settings_options
@click.option("--format", "format_", type=click.Choice(["table", "json"]), default="table", show_default=True)
def command(config_file: Path | None, data: Path | None, database: str | None, format_: str) -> None:
    """Show every setting, its value and its source; secrets are masked."""
    from robomend.settings import Settings, shown

    settings, sources = read_settings(config_file, data=data, database=database)
    values = shown(settings)
    if format_ == "json":
        table = {name: {"value": value, "source": sources[name]} for name, value in values.items()}
        click.echo(json.dumps(table, indent=2))
        return
    width = max(map(len, values))
    for name, value in values.items():
        text = Settings.model_fields[name].description
        click.echo(f"{name:<{width}}  {json.dumps(value)}  # {sources[name]}" + (f"; {text}" if text else ""))
