"""Which media type a client would rather have: the header `Accept` (RFC 9110, 12.5.1)."""

from __future__ import annotations

import re

_WEIGHT = re.compile(r"(?:0(?:\.\d{0,3})?|1(?:\.0{0,3})?)\Z")


def quality(accept: str, media_type: str) -> float:
    """Return how much the header wants a media type, 0 to 1; the most specific range that fits counts.

    A header that is empty or missing takes everything. A range that is malformed counts for nothing.
    """
    if not accept.strip():
        return 1.0
    kind = media_type.partition("/")[0]
    fits = {"*/*": 0, f"{kind}/*": 1, media_type: 2}
    best = (-1, 0.0)
    for one in accept.split(","):
        name, *parameters = (part.strip().lower() for part in one.split(";"))
        if name not in fits:
            continue
        weights = [value for key, _, value in (p.partition("=") for p in parameters) if key == "q"]
        weight = weights[-1] if weights else "1"
        if _WEIGHT.match(weight):
            best = max(best, (fits[name], float(weight)))
    return best[1]
