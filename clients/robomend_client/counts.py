"""Numbers with what they count, as people say them."""

from __future__ import annotations


def counted(count: int, one: str, many: str = "") -> str:
    """Return `1 log`, `2 logs`, `1,200 logs`; `many`: where it takes more than an s."""
    return f"{count:,} {one if count == 1 else many or f'{one}s'}"
