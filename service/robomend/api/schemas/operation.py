"""Whether the service can serve."""

from __future__ import annotations

from pydantic import Field

from robomend.api.schemas.base import Out


class Check(Out):
    """How one part is."""

    ok: bool
    detail: str


class Readiness(Out):
    """Whether this instance can serve requests."""

    ready: bool
    checks: dict[str, Check]


class Operation(Out):
    """Something that may be asked for."""

    method: str = Field(examples=["GET"])
    path: str = Field(description="a template", examples=["/api/v1/robots/{robot}"])


class Root(Out):
    """What this service is, and what whoever asks may do."""

    name: str = Field(examples=["robomend"])
    version: str
    operations: list[Operation]
    openapi: str = "/openapi.json"
    docs: str = "/docs"
