"""What a request's headers say of where it comes from.

A browser that asks for a page of another origin says so in Origin and in Sec-Fetch-Site.

Other clients send neither. A browser sends Origin with every change and with reads by a script of another
origin, Sec-Fetch-Site with every request, images and forms included (old ones do not).
"""

from __future__ import annotations

from starlette.types import Scope

OURS = frozenset({b"same-origin", b"none"})
"""none: somebody typed the address, or followed a bookmark."""


def foreign(scope: Scope) -> str | None:
    """Return the header by which the request is known to come from a page of another origin, or None."""
    origin = site = None
    host = b""
    for name, value in reversed(scope["headers"]):  # of a repeated header, the first
        if name == b"origin":
            origin = value.lower()
        elif name == b"sec-fetch-site":
            site = value
        elif name == b"host":
            host = value.lower()
    if origin is not None:
        kind, _, authority = origin.partition(b"://")
        # A secure page may come through a proxy that ends TLS; a plain one is foreign to a secure service.
        downgraded = kind == b"http" and scope["scheme"] == "https"
        if downgraded or authority != host:
            return "Origin"
    return None if site is None or site in OURS else "Sec-Fetch-Site"


def first(scope: Scope, name: bytes) -> str | None:
    """Return a header of a request, of a repeated one the first, or None; `name` in lower case.

    Starlette's mapping of headers gives the same, with an exception inside for each that is not there.
    """
    for known, value in scope["headers"]:
        if known == name:
            found: bytes = value
            return found.decode("latin-1")
    return None
