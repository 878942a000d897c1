"""What would be done: choices, plans and their steps."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import Out


class StepOut(Out):
    """A step of a plan, in a valid serial order."""

    index: int = Field(examples=[0])
    name: str = Field(examples=["power_up"])
    parameters: list[str] = Field(examples=[["jaguar"]])
    cost: float = Field(examples=[3.0])
    after: list[int] = Field(description="steps that must be done before it, by their index")
    preconditions: list[str] = Field(examples=[["not on(jaguar)"]])
    effects: list[str] = Field(examples=[["on(jaguar)"]])
    text: str = Field(examples=["power_up(jaguar)"])


class GraphOut(Out):
    """A plan as a graph: what may be done at the same time."""

    nodes: list[str] = Field(examples=[["power_up(jaguar)"]])
    edges: list[list[int]] = Field(description="pairs: the first before the second")
    layers: list[list[int]] = Field(description="steps by the earliest moment at which they can start")


class PddlOut(Out):
    """What the planner was given."""

    domain: str
    problem: str


class PlanOut(Out):
    """How components come to work again."""

    outcome: Literal["solved", "unsolvable", "gave-up"]
    steps: list[StepOut]
    cost: float
    planner: str = Field(examples=["pyperplan"])
    assumed: list[str] = Field(description="what nobody observed, and was taken to be so")
    unreachable: list[str] = Field(description="what the plan leaves broken")
    excluded: list[str] = Field(description="actions that were not considered, and why")
    elapsed_s: float
    pddl: PddlOut | None = Field(description="where it was asked for")
    graph: GraphOut


class ChosenDiagnosis(Out):
    """The diagnosis that is planned for."""

    bad: list[str] = Field(examples=[["jaguar"]])
    good: list[str] = Field(examples=[["hokuyo", "imu"]])
    probability: float | None
    weight: float | None = Field(description="its share among those that were weighed")


class AlternativeOut(Out):
    """Another diagnosis that was weighed, and what its repair would be."""

    bad: list[str]
    good: list[str]
    probability: float | None
    weight: float | None
    outcome: Literal["solved", "unsolvable", "gave-up"]
    actions: list[str] = Field(examples=[["power_up(jaguar)"]])
    cost: float
    helps: float = Field(description="the probability that it repairs what is wrong")
    failures: int = Field(description="how often it did not help lately")
    unreachable: list[str]
    reason: str


class LookOut(Out):
    """An observation that costs less than acting in doubt."""

    observe: str = Field(examples=["on(jaguar)"])
    cost: float


class ChoiceOut(Out):
    """What to do first: a plan for a diagnosis, or a look; null: nothing."""

    choice: ChosenDiagnosis | None
    plan: PlanOut | None
    probe: LookOut | None
    alternatives: list[AlternativeOut]
    expected_cost: float
    reason: str
