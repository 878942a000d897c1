"""Models as versioned resources."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import In, Moment, Out, moment_of


class ModelBody(In):
    """A model as it is written: component model (YAML), five-key model or .bench circuit."""

    source: str = Field(
        min_length=1,
        max_length=64 << 20,
        examples=["robomend: 1\nname: lamp\nhardware:\n  battery: {channel: 1}\nnodes: {}\n"],
    )
    format: Literal["component", "five-key", "bench"] | None = Field(
        default=None, description="null: found out from the text"
    )


class ModelOut(Out):
    """One version of a model, with what its loader had to say."""

    name: str
    version: str = Field(description="the ETag's content")
    number: int
    format: str
    source: str
    components: list[str]
    warnings: list[str]
    created_ns: int
    created: Moment = moment_of("created_ns")
    by: str


class VersionOut(Out):
    """One version in the list of a model's versions, or one model in the list of models."""

    name: str
    version: str
    number: int
    format: str
    created_ns: int
    created: Moment = moment_of("created_ns")
    by: str
