"""Plans, repairs, the agent's side of them, and the power board."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from robomend.api.schemas.base import (
    MAX_INT,
    Component,
    In,
    ModelName,
    Moment,
    Out,
    Reason,
    Sentence,
    moment_of,
)
from robomend.api.schemas.robots import ExpectedBody


class PlanBody(In):
    """Plan without acting."""

    bad: list[Component] | None = Field(
        default=None, max_length=10_000, description="null: choose among the diagnoses"
    )
    planner: str | None = Field(default=None, max_length=64)
    timeout_s: float = Field(default=10.0, gt=0, le=600)
    pddl: bool = Field(default=False, description="include domain and problem")


class OneShotPlanBody(In):
    """A stateless plan: model, observations and what is bad in, plan out."""

    model: ModelName | None = None
    source: str | None = Field(default=None, min_length=1, max_length=64 << 20)
    observations: list[Sentence] = Field(default=[], max_length=10_000)
    bad: list[Component] | None = Field(
        default=None, max_length=10_000, description="null: the first diagnosis"
    )
    expected: ExpectedBody = Field(default_factory=ExpectedBody)
    planner: str = Field(default="pyperplan", max_length=64)
    timeout_s: float = Field(default=10.0, gt=0, le=600)
    pddl: bool = False


class RepairBody(In):
    """Ask for a repair."""

    bad: list[Component] | None = Field(
        default=None, max_length=10_000, description="null: choose among the diagnoses"
    )
    reason: Reason = ""


class DecisionBody(In):
    """Decide on a repair."""

    decision: Literal["approve", "cancel"]
    reason: Reason = ""


class ReasonBody(In):
    """Why; it goes to the audit log."""

    reason: Reason = ""


class ChannelBody(In):
    """Switch a channel."""

    on: bool
    reason: Reason = ""


class FeedbackBody(In):
    """How far an action is."""

    code: int = Field(ge=-(2**31), le=2**31 - 1)
    message: str = Field(default="", max_length=4000)


class ActionResultBody(In):
    """The end of an action; 0 is success (the paper's integer result)."""

    code: int = Field(ge=-(2**31), le=2**31 - 1, examples=[0])
    message: str = Field(default="", max_length=4000)


class ObservesBody(In):
    """An atom that an agent observes, and how fast its observers are."""

    atom: Sentence = Field(examples=["ok(scan)"])
    detection_s: float = Field(ge=0, le=86400, description="from a fault to its verdict, at most")
    settling_s: float = Field(ge=0, le=86400, description="from `settle` to a verdict, at most")


class PollBody(In):
    """An agent asks what there is to do, and says what it can."""

    agent: str = Field(min_length=1, max_length=253)
    host: str | None = Field(default=None, max_length=253, description="null: the robot's only agent")
    can: list[Sentence] | None = Field(
        default=None,
        max_length=10_000,
        description="`name` or `name:parameter,parameter` of each action; null: anything",
        examples=[["start_node:hokuyo_node", "stop_node:hokuyo_node"]],
    )
    takes_s: dict[Sentence, Annotated[float, Field(gt=0, le=86400)]] = Field(
        default={},
        max_length=10_000,
        description="how long an answer may take: of a `name`, or of `name:parameter,parameter`",
        examples=[{"calibrate": 30.0}],
    )
    observes: list[ObservesBody] = Field(default=[], max_length=10_000)
    settled: int | None = Field(default=None, ge=0, le=MAX_INT, description="the newest `n` it acted on")
    wait_s: float = Field(default=0.0, ge=0, le=3600, description="wait this long for something to do")


class ActionOut(Out):
    """What an agent is asked to do; `id` is the same when it is asked again."""

    id: str = Field(examples=["r-7k2m9x4q:2"])
    name: str = Field(examples=["start_node"])
    parameters: list[str] = Field(examples=[["jaguar_node"]])
    timeout_s: float
    host: str | None = None


class SettleOut(Out):
    """What the agent's observers are to judge anew, from now on, whatever they have seen."""

    n: int = Field(description="goes back as `settled`, with the verdicts that answer this")
    atoms: list[str] = Field(examples=[["ok(scan)", "running(hokuyo_node)"]])


class OrdersOut(Out):
    """What an agent is asked to do: an action, as GET gives it, or to judge anew, or both."""

    id: str | None = Field(None, examples=["r-7k2m9x4q:2"])
    name: str | None = Field(None, examples=["start_node"])
    parameters: list[str] | None = Field(None, examples=[["jaguar_node"]])
    timeout_s: float | None = None
    host: str | None = None
    settle: SettleOut | None = None


class FirstResult(Out):
    """The result that counts: that of the first report."""

    code: int
    message: str


class StopOut(Out):
    """The global stop."""

    active: bool
    by: str | None = None
    reason: str = ""
    since_ns: int | None = None
    since: Moment | None = moment_of("since_ns")
    written: bool = Field(default=True, description="false: not on disk yet; a restart would not know of it")
    detail: str = Field(default="", description="what that means, where it is not written")


class ChannelOut(Out):
    """A channel of the power board; null is unknown."""

    channel: int
    component: str | None
    on: bool | None
    current_a: float | None
    voltage_v: float | None
    protected: bool


class BoardOut(Out):
    """The robot's power board."""

    host: str
    port: int
    state: str = Field(examples=["connected"])
    reason: str
    time_ns: int
    time: Moment = moment_of("time_ns")
    channels: list[ChannelOut]


# --- what would be done: choices, plans and their steps


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
