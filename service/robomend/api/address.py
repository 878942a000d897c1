"""The URL of a listening socket."""

from __future__ import annotations


def url_of(address: tuple[object, ...], *, secure: bool) -> str:
    """Return the URL that reaches a listening socket from this computer."""
    host, port = str(address[0]), address[1]
    if host in {"0.0.0.0", "::"}:
        host = "127.0.0.1" if host == "0.0.0.0" else "::1"
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if secure else 'http'}://{shown}:{port}"
