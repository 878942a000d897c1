"""What commands that diagnose share: the argument MODEL, and what bounds a search (--minimal, --max-size,
--limit, --timeout).
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.files import near_file
from robomend.errors import ModelError

if TYPE_CHECKING:
    from robomend.diagnosis.result import Options
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


def search_options(given: dict[str, Any], **others: Any) -> Options:
    """Return the options of a search.

    Args:
        given: of the command line, these four among them.
        others: what else is known of the search.
    """
    from robomend.diagnosis.result import Options

    timeout = given["timeout"]
    if math.isnan(timeout) or timeout < 0:
        raise click.UsageError("--timeout is a number of seconds, 0 or more")
    return Options(
        minimal=given["minimal"],
        max_size=given["max_size"],
        limit=given["limit"] or None,
        timeout_s=None if math.isinf(timeout) else timeout,
        **others,
    )
