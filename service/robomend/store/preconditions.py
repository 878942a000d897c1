"""What the writer of a model or a robot has seen of it: the ETag that is compared before it is replaced.

`expected` is that ETag. None means "it must not exist yet": PreconditionRequired when it does. ABSENT says
the same, as `If-None-Match: *` does: PreconditionFailed when it does. ANY means "whichever". Another than the
current one is PreconditionFailed.
"""

from __future__ import annotations

from robomend.errors import PreconditionFailed, PreconditionRequired
from robomend.store.records import ABSENT, ANY


def check(what: str, expected: str | None, current: str | None) -> None:
    """Compare the version that the caller has seen with the current one; None: it does not exist."""
    if current is None:
        if expected not in (None, ABSENT):
            raise PreconditionFailed(f"{what} does not exist; leave If-Match out to create it")
    elif expected is None:
        raise PreconditionRequired(f"{what} exists; send its ETag as If-Match to replace it")
    elif expected == ABSENT:
        raise PreconditionFailed(f"{what} exists already")
    elif expected not in (ANY, current):
        raise PreconditionFailed(f"{what} is at version {current}, not {expected}; read it again")
