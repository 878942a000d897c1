"""The known name that was probably meant, for the error about one that nobody knows."""

from __future__ import annotations

from collections.abc import Callable, Iterable

LOOKED_AT = 20_000
"""Names compared at most; a circuit has more nets than anybody waits for."""

LONGEST = 200
"""Characters of a name that are compared: comparing takes their square."""


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is spelt most alike; None if none is near."""
    from difflib import get_close_matches  # not before somebody has mistyped something

    near = get_close_matches(name[:LONGEST], sorted(known)[:LOOKED_AT], n=1)
    return near[0] if near else None


def did_you_mean(name: str, known: Iterable[str], shown: Callable[[str], str] = repr) -> str:
    """Return `; did you mean 'scan'?`, to be put behind an error; nothing where no known name is near.

    Args:
        name: what was written.
        known: what could have been meant.
        shown: how to write the name in the answer.
    """
    near = nearest(name, known)
    return "" if near is None else f"; did you mean {shown(near)}?"
