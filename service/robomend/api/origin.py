"""What a request's headers say of where it comes from.

A browser that asks for a page of another origin says so in Origin and in Sec-Fetch-Site.

Other clients send neither. A browser sends Origin with every change and with reads by a script of another
origin, Sec-Fetch-Site with every request, images and forms included (old ones do not).
"""

from __future__ import annotations

from starlette.types import Scope

OURS = frozenset({b"same-origin", b"none"})
"""none: somebody typed the address, or followed a bookmark."""


BY_NAME = "robomend.headers"
"""In a scope: its headers by their names; see `by_name`."""


def by_name(scope: Scope) -> dict[bytes, bytes]:
    """Return a request's headers by their names in lower case, of a repeated one the first.

    Starlette's mapping gives the same, with an exception inside for each that is not there.
    """
    found: dict[bytes, bytes] | None = scope.get(BY_NAME)
    if found is None:
        found = scope[BY_NAME] = dict(reversed(scope["headers"]))
    return found


def foreign(scope: Scope) -> str | None:
    """Return the header by which the request is known to come from a page of another origin, or None."""
    headers = by_name(scope)
    origin, site = headers.get(b"origin"), headers.get(b"sec-fetch-site")
    if origin is None and site is None:
        return None
    if origin is not None:
        kind, _, authority = origin.lower().partition(b"://")
        # A secure page may come through a proxy that ends TLS; a plain one is foreign to a secure service.
        downgraded = kind == b"http" and scope["scheme"] == "https"
        if downgraded or authority != headers.get(b"host", b"").lower():
            return "Origin"
    return None if site is None or site in OURS else "Sec-Fetch-Site"
