"""Types by their names: std_msgs/msg/String, nav2_msgs/action/NavigateToPose."""

from __future__ import annotations

import importlib
from typing import Any


def load_message(name: str) -> Any:
    """Return the class of a message or an action.

    Raises:
        ImportError, AttributeError, ValueError: it is not built here, or no name.
    """
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)
