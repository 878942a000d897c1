"""What is wrong with the head of a request, before anybody looks at what it asks for."""

from __future__ import annotations

from collections.abc import Sequence

from robomend.api.problems import Problem

VERSIONS = frozenset({"1.0", "1.1"})


def fault_of(
    url: bytes, headers: Sequence[tuple[bytes, bytes]], version: str, most_bytes: int
) -> Problem | None:
    """Return why a request with this head is refused, or None."""
    size, hosts, coding = len(url), 0, b""
    for name, value in headers:
        size += len(name) + len(value)
        hosts += name == b"host"
        if name == b"transfer-encoding":
            coding = value.strip().lower()
    if size > most_bytes:
        return too_large(most_bytes)
    if version not in VERSIONS:
        return Problem(505, f"HTTP/{version} is not spoken here: HTTP/1.1 is")
    if hosts > 1:  # which one a proxy before us has looked at is anybody's guess
        return Problem(400, "there is more than one Host header")
    if hosts < 1 and version == "1.1":
        return Problem(400, "there is no Host header")
    if coding and (coding != b"chunked" or version != "1.1"):  # others may frame it otherwise
        return Problem(400, f"of HTTP/{version}, this Transfer-Encoding is not read here")
    return None


def too_large(most_bytes: int) -> Problem:
    """Return what is answered to a head of more bytes than that."""
    return Problem(431, f"the head of the request has more than {most_bytes} bytes")
