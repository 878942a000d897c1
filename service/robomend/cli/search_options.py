"""What bounds a search for diagnoses, as commands say it: --minimal, --max-size, --limit, --timeout."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from robomend.diagnosis.result import Options


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
