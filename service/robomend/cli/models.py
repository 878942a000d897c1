"""The MODEL argument of the one-shot commands."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robomend.model.system import System


def load(model: str) -> System:
    """Return the system description in a file, or on stdin for `-`."""
    from robomend.model.loading import load_model, load_text

    if model == "-":
        return load_text(sys.stdin.read(), name="stdin", file="stdin")
    return load_model(model)


def is_snapshot_file(model: str) -> bool:
    """Return whether a file is a system with several observations, which is diagnosed as a whole."""
    return model.endswith((".wcnf", ".wcnf.gz"))
