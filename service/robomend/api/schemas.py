"""What comes in and goes out over HTTP: types, limits and examples. The core never sees these classes.

Unknown fields of a request are refused, so that a misspelt one is not silently without effect. Keys are the
words of the literature; AB(c) is `bad` here, as in the paper.
"""

from __future__ import annotations

from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

T = TypeVar("T")

MAX_INT = 2**63 - 1

NAME = r"^[A-Za-z0-9][A-Za-z0-9._\-]{0,63}$"
RobotId = Annotated[str, Field(pattern=NAME, examples=["tedusar-1"])]
ModelName = Annotated[str, Field(pattern=NAME, examples=["tedusar"])]
Component = Annotated[str, Field(min_length=1, max_length=200, examples=["jaguar"])]
Sentence = Annotated[str, Field(min_length=1, max_length=4000, examples=["not ok(scan)"])]
Nanoseconds = Annotated[int, Field(ge=0, le=MAX_INT, examples=[1764000000000000000])]
Reason = Annotated[str, Field(max_length=1000, examples=["the laser was cleaned"])]


class In(BaseModel):
    """A request body."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


class Out(BaseModel):
    """An answer; new fields may come, so clients skip those that they do not know."""

    model_config = ConfigDict(frozen=True)


class ProblemBody(Out):
    """Problem details (RFC 9457); `code` is stable, `detail` is for people."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(examples=["urn:robomend:problem:not-found"])
    title: str = Field(examples=["Not Found"])
    status: int = Field(examples=[404])
    code: str = Field(examples=["not-found"])
    detail: str = Field(examples=["there is no robot 'r2'"])
    request_id: str | None = Field(default=None, examples=["5f0c9a"])


class Items(Out, Generic[T]):
    """One page of a list; `next` is the cursor of the following one, null on the last."""

    items: list[T]
    next: str | None = Field(default=None, examples=[None])


# --- models


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
    by: str


class VersionOut(Out):
    """One version in the list of a model's versions, or one model in the list of models."""

    name: str
    version: str
    number: int
    format: str
    created_ns: int
    by: str


# --- robots


class ExpectedCurrentBody(In):
    """What a channel's load draws when all is well."""

    current_a: float = Field(ge=0, le=1000, examples=[1.2])
    tolerance_a: float = Field(ge=0, le=1000, examples=[0.3])


class BoardBody(In):
    """Where the robot's power board is, and which channels are never shut down."""

    host: str = Field(min_length=1, max_length=253, examples=["127.0.0.1"])
    port: int = Field(ge=1, le=65535, examples=[10001])
    rate_hz: int = Field(default=5, ge=1, le=255, description="of the broadcast that is asked for")
    protected: list[Annotated[int, Field(ge=0, le=255)]] = Field(default=[2], max_length=256)
    expected_currents: dict[Annotated[str, Field(pattern=r"^\d{1,3}$")], ExpectedCurrentBody] = Field(
        default={}, max_length=256, description="by channel"
    )


class LimitsBody(In):
    """How much an automatic repair may try."""

    attempts_per_hour: int = Field(default=12, ge=0, le=100_000, description="actions on one component")
    rounds: int = Field(default=5, ge=1, le=1000, description="of one repair: diagnose, plan, act")


class ExpectedBody(In):
    """What is meant to be as it is."""

    stopped: list[Component] = Field(
        default=[], max_length=10_000, description="nodes that are meant to be stopped"
    )


class DiagnosisOptionsBody(In):
    """How far the engine searches; see POST /diagnoses."""

    engine: str = Field(default="sat", max_length=64, examples=["sat"])
    minimal: Literal["cardinality", "subset"] = "subset"
    max_size: int | None = Field(default=None, ge=0, le=100_000)
    limit: int = Field(default=100, ge=1, le=10_000)
    timeout_s: float | None = Field(default=None, gt=0, le=3600, description="null: the service's own")


class ExecutorBody(In):
    """Who carries out an action: what the kind needs is in `options`."""

    kind: Literal["board", "process", "agent", "webhook"]
    options: dict[Annotated[str, Field(max_length=64)], Any] = Field(default={}, max_length=32)


class ActionBody(In):
    """What differs for one action of the domain; null: as for the others."""

    policy: Literal["observe", "approve", "auto"] | None = None
    executor: ExecutorBody | None = None
    timeout_s: float | None = Field(default=None, gt=0, le=86400, description="for the executor's answer")
    effect_timeout_s: float | None = Field(
        default=None, gt=0, le=86400, description="from the answer to its effect"
    )
    retries: int | None = Field(default=None, ge=0, le=100)


class WindowBody(In):
    """A maintenance window in UTC; an end before the start is past midnight."""

    weekdays: list[Annotated[int, Field(ge=0, le=6)]] = Field(
        default=[0, 1, 2, 3, 4, 5, 6], min_length=1, max_length=7, description="0 is Monday"
    )
    start: str = Field(pattern=r"^([01][0-9]|2[0-3]):[0-5][0-9]$", examples=["22:00"])
    end: str = Field(pattern=r"^([01][0-9]|2[0-3]):[0-5][0-9]$", examples=["05:30"])


class RobotBody(In):
    """A robot: its model, how it is diagnosed, and what repair may do."""

    model: ModelName
    policy: Literal["observe", "approve", "auto"] = Field(
        default="approve", description="observe: never act; approve: a person says yes; auto"
    )
    limits: LimitsBody = Field(default_factory=LimitsBody)
    allow: list[Annotated[str, Field(min_length=1, max_length=200)]] | None = Field(
        default=None, max_length=1000, description="names of actions that may run; null: all of the domain"
    )
    protected: list[Component] = Field(default=[], max_length=10_000)
    board: BoardBody | None = None
    expected: ExpectedBody = Field(default_factory=ExpectedBody)
    observed: list[Sentence] = Field(
        default=[], max_length=10_000, description="literals that the observers will report, with either sign"
    )
    observed_timeout_s: float = Field(default=30.0, gt=0, le=86400)
    hold_s: float = Field(default=0.0, ge=0, le=86400, description="before an automatic repair")
    debounce_s: float = Field(
        default=0.0, ge=0, le=3600, description="OBS must be quiet this long; at most ten times it"
    )
    period_s: float | None = Field(
        default=None, ge=0.05, le=86400, description="diagnose this often, changed or not"
    )
    unknown: Literal["refuse", "keep"] = Field(
        default="refuse", description="names that the model does not declare"
    )
    diagnosis: DiagnosisOptionsBody = Field(default_factory=DiagnosisOptionsBody)
    planner: str = Field(default="pyperplan", max_length=64, examples=["pyperplan"])
    domain: str | None = Field(default=None, max_length=1 << 20, description="the user's own PDDL actions")
    actions: dict[Annotated[str, Field(max_length=200)], ActionBody] = Field(
        default={}, max_length=1000, description="by name: what differs for this action"
    )
    windows: list[WindowBody] = Field(
        default=[], max_length=100, description="automatic repair only inside one of these; none: always"
    )


class RobotOut(Out):
    """A robot as it is configured, and how it is."""

    id: str
    config: RobotBody
    etag: str
    created_ns: int
    updated_ns: int
    revision: int = Field(description="of OBS; each accepted batch raises it")
    model_version: str | None = None
    healthy: bool | None = Field(default=None, description="null: not diagnosed yet")


class RobotLine(Out):
    """A robot in the list of robots."""

    id: str
    model: str
    policy: str
    etag: str
    updated_ns: int


# --- observations


class ObservationsBody(In):
    """One batch of sentences, observed by one source at one time."""

    observations: list[Sentence] = Field(
        default=[], max_length=10_000, examples=[["not ok(scan)", "on(hokuyo)"]]
    )
    assertions: dict[Annotated[str, Field(min_length=1, max_length=200)], Sentence] = Field(
        default={}, max_length=1000, description="named sentences, kept until they are withdrawn"
    )
    time: Nanoseconds | None = Field(default=None, description="nanoseconds since the epoch; null: now")
    source: str = Field(default="http", min_length=1, max_length=200, examples=["general_observer"])
    lifetime_s: float | None = Field(
        default=None, gt=0, le=10 * 365 * 86400, description="after it the literals are unknown"
    )
    together: bool = Field(
        default=True, description="false: keep the good sentences of the batch, report the rest"
    )


class RefusedSentence(Out):
    """A sentence that was not kept, and why."""

    sentence: str
    position: int
    message: str


class Accepted(Out):
    """What became of a batch. `changed` are the literals that OBS now holds anew."""

    revision: int
    changed: list[str]
    refused: list[RefusedSentence] = []


class Ingested(Out):
    """What became of an NDJSON stream."""

    revision: int
    lines: int
    accepted: int


class ObservedLiteral(Out):
    """One literal of OBS."""

    literal: str = Field(examples=["not ok(scan)"])
    source: str
    time_ns: int
    expires_ns: int | None = None
    fresh: bool = Field(description="false: it has outlived its lifetime and is unknown")
    used: bool = Field(description="false: no rule of the model mentions it")


class AssertionOut(Out):
    """A named sentence of OBS."""

    name: str
    sentence: str
    source: str
    time_ns: int
    expires_ns: int | None = None


class ObsOut(Out):
    """OBS now."""

    revision: int
    observations: list[ObservedLiteral]
    assertions: list[AssertionOut]


# --- diagnoses


class DiagnosisOut(Out):
    """A minimal diagnosis: these are bad, all others good."""

    bad: list[str] = Field(examples=[["hokuyo"]])
    good: list[str] = Field(examples=[["jaguar", "imu"]])
    probability: float | None = None
    modes: dict[str, str] = {}
    text: str = Field(examples=["hokuyo is abnormal"])


class ConflictOut(Out):
    """Components that cannot all be healthy, given these observations."""

    components: list[str]
    observations: list[str]
    rules: list[str]
    text: str


class ResultOut(Out):
    """The answer of an engine. One empty diagnosis means healthy."""

    diagnoses: list[DiagnosisOut]
    complete: bool
    stopped_by: Literal["limit", "size", "time"] | None
    conflicts: list[ConflictOut]
    elapsed_s: float
    unused: list[str] = Field(default=[], description="observations that no rule mentions")
    count: int | None = None
    cleared: dict[str, str] = Field(default={}, description="healthy suspect -> why it is cleared")
    learned: dict[str, str] = Field(default={}, description="observation -> whom it raises suspicion of")


class FaultOut(Out):
    """Why there is no result for these observations."""

    code: str
    detail: str


class CurrentDiagnosis(Out):
    """The diagnosis of a robot's OBS at `revision`."""

    robot: str
    revision: int
    model_version: str | None
    time_ns: int | None
    result: ResultOut | None = Field(
        description="null: there is none; `fault` says why, or nothing was diagnosed yet"
    )
    fault: FaultOut | None = None
    expected_stopped: list[str] = Field(
        default=[], description="nodes that are meant to be stopped: that they do not run is no fault here"
    )


class AskBody(In):
    """A stateless diagnosis: model and observations in, result out."""

    model: ModelName | None = Field(default=None, description="a stored model; or `source`")
    source: str | None = Field(
        default=None, min_length=1, max_length=64 << 20, description="a model's text; or `model`"
    )
    observations: list[Sentence] = Field(default=[], max_length=10_000, examples=[["not ok(scan)"]])
    healthy: list[Component] = Field(
        default=[], max_length=10_000, description="what if these were healthy …"
    )
    abnormal: list[Component] = Field(default=[], max_length=10_000, description="… and these abnormal?")
    options: DiagnosisOptionsBody = Field(default_factory=DiagnosisOptionsBody)


class ProbeOut(Out):
    """An observation worth making next."""

    atom: str = Field(examples=["ok(map)"])
    gain_bits: float = Field(description="expected information")
    cost_s: float
    if_true: list[list[str]] = Field(description="the diagnoses that predict true …")
    if_false: list[list[str]] = Field(description="… and false; the others allow both")


class ProbesOut(Out):
    """What to look at next, best first."""

    revision: int
    probes: list[ProbeOut]
    entropy_bits: float = Field(description="how uncertain the diagnosis is; no probe can tell more")
    complete: bool = Field(description="every observable and every diagnosis found was considered")
    reason: str | None = Field(description="why no probe can discriminate")


# --- repair


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


class ActionOut(Out):
    """What an agent is asked to do; `id` is the same when it is asked again."""

    id: str = Field(examples=["r-7k2m9x4q:2"])
    name: str = Field(examples=["start_node"])
    parameters: list[str] = Field(examples=[["jaguar_node"]])
    timeout_s: float
    host: str | None = None


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
    channels: list[ChannelOut]


class AuditOut(Out):
    """Who did what to what, and why."""

    id: int
    time_ns: int
    actor: str
    action: str
    subject: str
    robot: str | None
    reason: str
    before: dict[str, Any] | None
    after: dict[str, Any] | None


class HistoryLine(Out):
    """An entry of a robot's history: an accepted batch, a diagnosis or a repair."""

    kind: Literal["observations", "diagnosis", "repair"]
    time_ns: int
    data: dict[str, Any]


# --- session


class SignInBody(In):
    """A browser signs in."""

    key: str = Field(max_length=100, examples=["rm_…"], description="from `robomend keys create`")


class SessionOut(Out):
    """Who makes the request."""

    name: str = Field(examples=["operator"], description="of the key")
    role: str = Field(examples=["operator"])
    robot: str | None = Field(description="of a robot's key: its own id")
    expires_ns: int | None = Field(description="of a browser that is signed in: when that ends")


# --- operation


class Check(Out):
    """How one part is."""

    ok: bool
    detail: str


class Readiness(Out):
    """Whether this instance can serve requests."""

    ready: bool
    checks: dict[str, Check]
