"""The MODEL argument of the one-shot commands."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from robomend.cli.files import near_file
from robomend.errors import ModelError

if TYPE_CHECKING:
    from robomend.model.system import System

MODEL = click.Path(allow_dash=True)
"""The type of the argument, so that shells complete it; `load` refuses what is no model, in its own words."""


def load(model: str) -> System:
    """Return the system description in a file, or on stdin for `-`; ModelError if there is none."""
    from robomend.model.loading import load_model, load_text

    if model == "-":
        return load_text(sys.stdin.read(), name="stdin", file="stdin")
    try:
        return load_model(model)
    except ModelError as error:
        if meant := near_file(model):
            raise ModelError(f"{error.message}{meant}", model) from error
        raise


def is_snapshot_file(model: str) -> bool:
    """Return whether a file is a system with several observations, which is diagnosed as a whole."""
    return model.endswith((".wcnf", ".wcnf.gz"))
