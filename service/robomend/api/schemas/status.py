"""All robots at a glance."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import Moment, Out, moment_of


class StatusLineOut(Out):
    """How a robot is, what is wrong with it and what it waits for, in words."""

    robot: str
    model: str
    policy: str
    state: Literal["healthy", "unhealthy", "degraded", "partly-unknown", "unknown"] | None = Field(
        description="null: not read yet, ask again"
    )
    headline: str = Field(
        description="what is wrong since when, what follows, and what happens next or who is needed",
        examples=["hokuyo has no power since 23:23:04; scan and 4 more follow. Power up hokuyo?"],
    )
    finding: str = Field(description="the leading diagnosis, or why there is none", examples=["hokuyo"])
    more: int = Field(description="diagnoses besides the leading one")
    waits: str = Field(description="what it waits for; empty: nothing", examples=["approval of a plan"])
    waits_for_person: bool
    since_ns: int | None = Field(description="of the diagnosis")
    since: Moment | None = moment_of("since_ns")


class StatusOut(Out):
    """A page of the robots that a search and a filter leave, the most urgent first."""

    robots: list[StatusLineOut]
    found: int = Field(description="how many the search and the filter leave")
    total: int
    counts: dict[str, int] = Field(description="robots by state, and those `waiting` for a person")
    page: int
    pages: int
    complete: bool = Field(description="false: some robots were not read yet, ask again")
