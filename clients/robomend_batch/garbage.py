"""Python's collector of garbage, told what the values here are like."""

from __future__ import annotations

import gc


def collect_less() -> None:
    """Look for circles of objects less often; for processes that do nothing but diagnose logs.

    Answers are very many tuples of names, none of which leads back to itself. Looking through all of them
    again and again, as more come, takes a quarter of the time; they are freed without it, by counting.
    """
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)
