"""Numbers with what they count, and long lists, as people say them."""

from __future__ import annotations

from collections.abc import Sequence


def counted(count: int, one: str, many: str = "") -> str:
    """Return `1 log`, `2 logs`, `1,200 logs`; `many`: where it takes more than an s."""
    return f"{count:,} {one if count == 1 else many or f'{one}s'}"


def listed(items: Sequence[object]) -> str:
    """Return `a`, `a and b`, `a, b and c`."""
    said = [str(item) for item in items]
    return " and ".join(filter(None, (", ".join(said[:-1]), *said[-1:])))


def first_few(items: Sequence[object], most: int, between: str = ", ") -> str:
    """Return `a, b, c and 4 more`: the first `most`, and how many are left out."""
    said = between.join(map(str, items[:most]))
    left = len(items) - most
    return f"{said}{';' if ';' in between else ''} and {left:,} more" if left > 0 else said
