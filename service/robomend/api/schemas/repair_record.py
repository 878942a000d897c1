"""A repair as it is kept: its rounds, their steps, and how far each came."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import Moment, Nanoseconds, Out, moment_of
from robomend.api.schemas.observations import ReadingOut
from robomend.repairs.states import ChangeState, RepairState, StepState


class BadAndGood(Out):
    """A diagnosis: these are bad, those good."""

    bad: list[str] = Field(examples=[["jaguar"]])
    good: list[str] = Field(examples=[["hokuyo", "imu"]])


class StepFeedback(Out):
    """How far an action said that it was."""

    code: int = Field(examples=[1])
    message: str = Field(examples=["half way"])
    time_ns: int
    time: Moment = moment_of("time_ns")


class RepairStep(Out):
    """A step of a repair, numbered over all its rounds, with the journal's entry of its action."""

    index: int = Field(examples=[0])
    name: str = Field(examples=["start_node"])
    parameters: list[str] = Field(examples=[["jaguar_node"]])
    after: list[int] = Field(description="steps that must be done before it")
    cost: float
    text: str = Field(examples=["start_node(jaguar_node)"])
    note: str | None = Field(default=None, description="what goes off with it, or stays on")
    state: StepState
    result: int | None = Field(description="the action's result code; 0 is success")
    message: str
    feedback: StepFeedback | None
    id: str | None = Field(default=None, description="of the action", examples=["r-7k2m9x4q:0"])
    seen: list[str] = Field(default=[], description="effects that were observed")
    missing: list[str] = Field(default=[], description="effects that were not")
    sent_ns: int | None = None
    sent: Moment | None = moment_of("sent_ns")
    ended_ns: int | None = None
    ended: Moment | None = moment_of("ended_ns")


class SeenSymptom(Out):
    """A literal that was seen, and since when."""

    literal: str = Field(examples=["not ok(scan)"])
    since_ns: int | None
    since: Moment | None = moment_of("since_ns")
    onset_ns: int | None
    onset: Moment | None = moment_of("onset_ns")
    reading: ReadingOut | None = Field(default=None, description="what was measured")
    blames: list[str] = Field(
        default=[], description="components of conflicts that rest on it; none: it follows from the others"
    )


class Rival(Out):
    """A diagnosis that was weighed and not chosen."""

    bad: list[str]
    weight: float
    helps: float
    cost: float | None
    why: str


class RepairRound(Out):
    """One round of a repair: what it rested on, what was done, how it ended."""

    began_ns: int | None = None
    began: Moment | None = moment_of("began_ns")
    diagnosis: BadAndGood
    plan: list[RepairStep]
    why: str = Field(description="the choice in words")
    ending: str | None = Field(description="null: it has not ended", examples=["done"])
    reason: str = ""
    helped: bool | None = None
    by_itself: str | None = Field(
        default=None, description="why it is well again, where that is credited to nobody"
    )
    undid: list[str] = Field(
        default=[], description="what held before it and fails since its acts: it did not help"
    )
    symptoms: list[SeenSymptom] = Field(default=[])
    symptoms_left_out: int = 0
    conflicts: list[str] = Field(default=[])
    weight: float | None = None
    rivals: list[Rival] = Field(default=[])
    after: list[SeenSymptom] = Field(
        default=[], description="of the symptoms, at its end, and what else did not hold then"
    )


class Unmended(Out):
    """What no known act mends."""

    began_ns: int
    began: Moment = moment_of("began_ns")
    diagnosis: BadAndGood
    symptoms: list[SeenSymptom]
    symptoms_left_out: int
    conflicts: list[str]
    rivals: list[Rival]


class RepairWait(Out):
    """What a repair waited for, and how long."""

    from_ns: int
    from_: Moment = moment_of("from_ns", alias="from")
    until_ns: int | None = Field(description="null: it still does")
    until: Moment | None = moment_of("until_ns")
    round: int = Field(description="before which round")
    why: str = Field(examples=["for verdicts that are about to come"])
    names: list[str] = Field(description="what was to be reported", examples=[["ok(scan)"]])


class WantedProbe(Out):
    """An atom that is looked at before anything is done."""

    atom: str = Field(examples=["on(jaguar)"])


class TakenUp(Out):
    """A repair that ended without success, and is taken up again after a while."""

    of: str = Field(examples=["r-7k2m9x4q"])
    why: str = Field(examples=["did not mend it", "broke"])
    times: int = Field(description="how often since somebody, or the diagnosis, began it", examples=[1])


class Doubt(Out):
    """An arrow of the model that what was seen contradicts: the output came while the input was silent."""

    node: str = Field(examples=["planner"])
    topic: str = Field(description="what it publishes", examples=["plan"])
    input: str = Field(description="what that is said to rest on", examples=["image"])
    text: str = Field(examples=["planner was healthy without image: that plan rests on it may be wrong"])


class RepairOut(Out):
    """A repair: its state, its present plan, and its rounds."""

    id: str = Field(examples=["r-7k2m9x4q"])
    robot: str = Field(examples=["tedusar-1"])
    headline: str = Field(
        default="",
        description="what is wrong since when, what follows, and what happens next or who is needed",
        examples=["hokuyo has no power since 23:23:04; scan and 4 more follow. Power up hokuyo?"],
    )
    state: RepairState
    policy: Literal["observe", "approve", "auto"] | None
    round: int = Field(examples=[1])
    diagnosis: BadAndGood | None
    plan: list[RepairStep]
    rounds: list[RepairRound]
    unmended: Unmended | None = Field(
        default=None, description="what is blamed after them that nothing is known to mend; null: nothing"
    )
    cost: float | None
    assumed: list[str]
    unreachable: list[str]
    doubts: list[Doubt] = Field(default=[])
    left_off: list[str] = Field(description="components that it switched off and did not bring back")
    waiting_for: list[str] = Field(description="literals that nobody has reported yet")
    waits: list[RepairWait] = Field(default=[], description="what it has waited for so far, the first ten")
    probe: WantedProbe | None
    reason: str
    drill: str | None = Field(description="the drill that it answers", examples=["d-7k2m9x4q"])
    optional: bool = Field(
        default=False, description="whether all that was blamed when it ended is optional: nobody is notified"
    )
    again: TakenUp | None = Field(default=None, description="the repair that it takes up by itself")
    retry_ns: Nanoseconds | None = Field(
        default=None, description="when the same is tried again by itself, unless it is well by then"
    )
    retry: Moment | None = None
    by: str | None = Field(examples=["robomend"])
    created_ns: Nanoseconds
    created: Moment
    updated_ns: Nanoseconds
    updated: Moment
    finished_ns: Nanoseconds | None
    finished: Moment | None
    account: list[str] | None = Field(
        default=None, description="the repair in words, of GET /repairs/{repair} alone"
    )


class VariantOut(Out):
    """A variant of a function."""

    variant: str = Field(examples=["high"])
    admissible: bool | None = Field(description="null: what its condition speaks of is not known")
    why: str = Field(
        description="why it is not admissible, or not changed to",
        examples=["visibility fell to 2.9, at least 3.25"],
    )


class FunctionOut(Out):
    """What the robot does in one of several variants, and how that stands now."""

    function: str = Field(examples=["altitude"])
    active: str | None = Field(description="null: nobody reports it, or several are reported")
    goal: str | None = Field(description="the best variant that is admissible; null: none is")
    works: bool = Field(description="whether the active variant is known to be admissible")
    criticality: Literal["essential", "normal", "optional"]
    held: str = Field(description="why a better variant is not changed to now, or what is not known")
    variants: list[VariantOut] = Field(description="the preferred first")


class FunctionsOut(Out):
    """The robot's functions; of a model without functions there are none."""

    functions: list[FunctionOut]


class FunctionChange(Out):
    """One function's change."""

    function: str = Field(examples=["altitude"])
    from_: str = Field(alias="from", examples=["high"])
    to: str = Field(examples=["medium"])
    reason: str = Field(examples=["visibility fell to 2.9, at least 3.25"])
    better: bool = Field(description="whether the new variant is preferred to the old one")
    fault: bool = Field(False, description="whether something that the old variant needs was blamed")
    back_ns: Nanoseconds | None = Field(description="when a change back was made")
    back: Moment | None
    held: str | None = Field(
        description="why it is not changed back, although that would do",
        examples=["high is admissible again, and not changed to: the policy for 'set_mode' is 'observe'"],
    )
    text: str


class ChangeOut(Out):
    """A change of configuration: of one function, or of several that depend on each other."""

    id: str = Field(examples=["c-7k2m9x4q"])
    robot: str
    state: ChangeState
    changes: list[FunctionChange]
    plan: list[RepairStep]
    cost: float | None
    reason: str
    by: str | None
    notify: bool = Field(description="whether people are told of it")
    changed_ns: Nanoseconds | None = Field(description="when the new variant was seen to be active")
    changed: Moment | None
    created_ns: Nanoseconds
    created: Moment
    updated_ns: Nanoseconds
    updated: Moment
    finished_ns: Nanoseconds | None
    finished: Moment | None
