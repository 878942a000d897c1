"""The versions of robomend and of the parts that decide its answers."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

PARTS = ("python-sat", "clingo", "unified-planning", "up-pyperplan", "fastapi", "uvicorn", "SQLAlchemy")


@cache
def version_info() -> dict[str, Any]:
    """Return name -> version; null for a part that is not installed."""
    return {
        "robomend": _version("robomend"),
        "python": platform.python_version(),
        "parts": {part: _version(part) for part in PARTS},
    }


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
