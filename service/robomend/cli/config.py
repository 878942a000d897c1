"""`robomend config`: the settings in force, each with where its value came from."""

from __future__ import annotations

import json
from pathlib import Path

import click

from robomend.cli.settings_options import read_settings, settings_options


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
