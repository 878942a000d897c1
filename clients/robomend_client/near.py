"""The known name that was probably meant, for the error about one that nobody knows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from heapq import nsmallest
from itertools import islice

LOOKED_AT = 2_000
"""Names looked at; a circuit has more nets than anybody waits for."""

COMPARED = 20
"""Of these the nearest in length and first letter are compared letter by letter: some milliseconds."""

LONGEST = 60
"""Characters of a name that are compared: comparing takes their square."""


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is spelt most alike; None if none is near.

    Args:
        name: what was written.
        known: what could have been meant; give what is in no order sorted, or the answer is in none.
    """
    from difflib import get_close_matches  # not before somebody has mistyped something

    def far(other: str) -> tuple[bool, int]:
        return other[:1] != name[:1], abs(len(other) - len(name))

    compared = nsmallest(COMPARED, sorted(islice(known, LOOKED_AT)), key=far)
    beginnings = {other[:LONGEST]: other for other in compared}
    near = get_close_matches(name[:LONGEST], beginnings, n=1)
    return beginnings[near[0]] if near else None


def did_you_mean(name: str, known: Iterable[str], shown: Callable[[str], str] = repr) -> str:
    """Return `; did you mean 'scan'?`, to be put behind an error; nothing where no known name is near.

    Args:
        name: what was written.
        known: what could have been meant, as in `nearest`.
        shown: how to write the name in the answer.
    """
    near = nearest(name, known)
    return "" if near is None else f"; did you mean {shown(near)}?"
