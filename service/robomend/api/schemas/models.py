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


class FiveKeyOut(Out):
    """The model that a robot follows, in the five keys of the published system's model server."""

    model: str
    version: str
    ab: str = Field(description="what says that a component is abnormal")
    nab: str = Field(description="and that it is not")
    neg_prefix: str = Field(description="what a negated proposition begins with")
    props: list[str] = Field(examples=[["ok(scan)"]])
    rules: list[str] = Field(description="the clauses", examples=[["NAB(laser)->ok(scan)"]])


class VersionOut(Out):
    """One version in the list of a model's versions, or one model in the list of models."""

    name: str
    version: str
    number: int
    format: str
    created_ns: int
    created: Moment = moment_of("created_ns")
    by: str
