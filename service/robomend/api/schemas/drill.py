"""Drills: a fault that is planted on purpose, and undone."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import Component, In, Moment, Nanoseconds, Out, Reason, moment_of
from robomend.api.schemas.repair_record import Doubt


class DrillBody(In):
    """Plant a fault. A person's yes is whoever asks for it."""

    fault: str = Field(min_length=1, max_length=64, examples=["node-killed"])
    component: Component | None = Field(
        default=None, description="what is at fault; null for what is of the board itself"
    )
    topic: str | None = Field(
        default=None,
        min_length=1,
        max_length=200,
        description="that the component publishes: of topic faults",
    )
    bound_s: float = Field(default=60.0, ge=1, le=3000, description="it is undone after this at the latest")
    detect_s: float = Field(
        default=15.0, ge=1, le=3000, description="… and after this where nothing is seen of it"
    )
    reason: Reason = ""


class DrillDecisionBody(In):
    """Say something about an open drill."""

    decision: Literal["cancel", "done", "abandon"] = Field(
        description="cancel: undo it now; done: a person did what it waits for; "
        "abandon: nothing more is to be undone by robomend"
    )
    reason: Reason = ""


class DrillSeenOut(Out):
    """What became of a planted fault."""

    detected_s: float | None = Field(description="from the act to the first diagnosis that is not healthy")
    diagnoses: list[list[str]] = Field(description="what was blamed before the first act of the repair")
    showed: dict[str, float] = Field(description="literal that turned -> seconds after the act")
    doubts: list[Doubt] = Field(default=[])
    acted_s: float | None = Field(default=None, description="when the repair's first act was sent")
    repair: str | None
    repair_state: str | None
    repair_reason: str | None
    repaired_s: float | None
    acts: list[str] = Field(examples=[["stop_node(jaguar_node)", "start_node(jaguar_node)"]])
    needless: list[str] = Field(description="acts on what was not faulty")


class DrillOut(Out):
    """A drill."""

    id: str = Field(examples=["d-7k2m9x4q"])
    robot: str
    state: str = Field(examples=["planted"])
    fault: str
    component: str | None
    topic: str | None = None
    planted_by: str = Field(examples=["agent"])
    act: str
    undo: str
    undone: bool = Field(description="what was planted is undone; true as well where nothing was")
    bound_s: float
    detect_s: float
    waiting_for: str | None = Field(description="what a person is to do, and to say `done` to")
    cut_short: str | None = Field(description="why it was not watched to its end")
    seen: DrillSeenOut | None
    reason: str
    by: str
    planted_ns: Nanoseconds | None
    planted: Moment | None = moment_of("planted_ns")
    created_ns: Nanoseconds
    created: Moment = moment_of("created_ns")
    updated_ns: Nanoseconds
    updated: Moment = moment_of("updated_ns")
    finished_ns: Nanoseconds | None
    finished: Moment | None = moment_of("finished_ns")
