"""What faults can show: the question and its answer."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import In, Out, RobotId, Sentence


class IsolabilityBody(In):
    """What is at hand: named, or what a robot's observers report; neither: all that the rules speak of."""

    observed: list[Sentence] | None = Field(
        default=None, max_length=10_000, examples=[["ok(scan)", "on(hokuyo)"]], description="observables"
    )
    robot: RobotId | None = Field(
        default=None, description="a robot that follows the model: `observed` of it, its board, its agents"
    )
    double: bool = Field(default=False, description="compare double faults, too: bounded")
    timeout_s: float | None = Field(
        default=None, gt=0, le=3600, description="null: the service's own, for a diagnosis"
    )


class SingleOrDoubleFault(Out):
    """Components that are abnormal together."""

    components: list[str]
    detectable: bool | None = Field(description="null: not known, for want of time")


class LeftTogether(Out):
    """What no observable of the model tells apart; an empty rival is a healthy robot."""

    fault: list[str]
    rival: list[str]


class FurtherOut(Out):
    """The cheapest further observables that split a group, as far as any can."""

    atoms: list[str]
    cost_s: float
    left: list[LeftTogether]
    all_looked_at: bool = Field(description="false: there are many, and the first ones were looked at")


class SuggestionOut(Out):
    """What could be added to the model, and what to watch then."""

    add: str = Field(examples=["not ab(camera) -> ok(current,camera)"])
    watch: str


class FaultGroup(Out):
    """Faults that cannot be told from one another, nor from the rivals."""

    faults: list[list[str]]
    rivals: list[list[str]]
    further: FurtherOut | None = Field(description="null: there was no time to look, or too many were asked")
    suggestions: list[SuggestionOut]
    text: str


class DoubleFaultsOut(Out):
    """Double faults that were compared with one another and with single ones."""

    faults: list[SingleOrDoubleFault]
    groups: list[FaultGroup]
    complete: bool = Field(description="false: there are more")


class IsolabilityOut(Out):
    """Which faults can be detected and told apart."""

    observed: list[str]
    unused: list[str] = Field(description="observables that no rule speaks of")
    faults: list[SingleOrDoubleFault]
    matrix: list[str] | None = Field(
        examples=[["=+", "-="]],
        description="a line a fault, a place for each: = itself, - never told from it, ~ by some of what it "
        "shows, + whatever it shows, ? not known; null for more than 500 faults",
    )
    groups: list[FaultGroup]
    undetectable: list[FaultGroup] = Field(description="one fault each")
    double: DoubleFaultsOut | None
    exact_by: Literal["signatures", "search"]
    complete: bool = Field(description="false: time ran out")
    elapsed_s: float
    text: list[str]
