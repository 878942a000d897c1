"""The options that every command on the service's settings shares:
where they come from, and which database.
"""

from __future__ import annotations

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
