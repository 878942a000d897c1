"""Whether the service can serve."""

from __future__ import annotations

from robomend.api.schemas.base import Out


class Check(Out):
    """How one part is."""

    ok: bool
    detail: str


class Readiness(Out):
    """Whether this instance can serve requests."""

    ready: bool
    checks: dict[str, Check]
