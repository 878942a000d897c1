"""How many examples of a property are tried where it needs more than others do.

Every property is tried on 100 examples with `--long`, on 30 without: conftest.py.
"""

from __future__ import annotations

from hypothesis import settings


def examples(at_full_length: int) -> settings:
    """Return settings for so many examples with `--long`, and otherwise for the share that others get."""
    return settings(max_examples=at_full_length * settings().max_examples // 100)
