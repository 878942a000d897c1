"""What is shown of secrets, and of addresses that may hold one."""

from __future__ import annotations

import re

COVERED = "**********"
"""What is shown of a webhook's secret. Put back as it is, it leaves the secret as it was."""

SECRET = re.compile(r"secret|token|password|credential|api_?key|(^|_)key$", re.IGNORECASE)
"""Options of executors with such names are shown to nobody."""


def shown_url(url: str) -> str:
    """Return an address without what may be a credential: its user, query and fragment."""
    scheme, separator, rest = url.partition("://")
    if not separator:
        return url
    end = min((place for mark in "/?#" if (place := rest.find(mark)) >= 0), default=len(rest))
    authority, path = rest[:end], rest[end:]
    if "@" in authority:
        authority = f"{COVERED}@{authority.rpartition('@')[2]}"
    for mark in "?#":
        beginning, found, _ = path.partition(mark)
        if found:
            path = f"{beginning}{mark}{COVERED}"
            break
    return f"{scheme}://{authority}{path}"
