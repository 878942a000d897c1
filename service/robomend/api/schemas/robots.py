"""What is configured of a robot."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from robomend.api.schemas.base import Component, In, ModelName, Moment, Out, Sentence, moment_of
from robomend.api.schemas.drill import DrillOut
from robomend.diagnosis.engines import ENGINES
from robomend.planning.planners import PLANNERS


class ExpectedCurrentBody(In):
    """What a channel's load draws when all is well."""

    current_a: float = Field(ge=0, le=1000, examples=[1.2], description="what the load draws, in amperes")
    tolerance_a: float = Field(
        ge=0, le=1000, examples=[0.3], description="how far the current may be from that, in amperes"
    )


class BoardBody(In):
    """Where the robot's power board is, and which channels are never shut down."""

    host: str = Field(
        min_length=1, max_length=253, examples=["127.0.0.1"], description="the board's name or address"
    )
    port: int = Field(ge=1, le=65535, examples=[10001], description="the board's TCP port")
    rate_hz: int = Field(
        default=5, ge=1, le=255, description="how often it is to tell what it measures, per second"
    )
    protected: list[Annotated[int, Field(ge=0, le=255)]] = Field(
        default=[2], max_length=256, description="channels that are never shut down"
    )
    expected_currents: dict[Annotated[str, Field(pattern=r"^\d{1,3}$")], ExpectedCurrentBody] = Field(
        default={}, max_length=256, description="channel → what its load draws when all is well"
    )
    control_port: int | None = Field(
        default=None,
        ge=1,
        le=65535,
        description="of an emulated board, the TCP port on which drills plant its faults",
    )


class LimitsBody(In):
    """How much an automatic repair may try."""

    attempts_per_hour: int = Field(
        default=12, ge=0, le=100_000, description="actions on one component in an hour"
    )
    rounds: int = Field(default=5, ge=1, le=1000, description="plans in one repair")


class ExpectedBody(In):
    """What is meant to be as it is."""

    stopped: list[Component] = Field(
        default=[], max_length=10_000, description="components that are meant to be stopped or off"
    )


class DiagnosisOptionsBody(In):
    """How far the engine searches; see POST /diagnoses."""

    engine: str = Field(
        default="sat",
        max_length=64,
        examples=["sat"],
        description=f"who searches: {', '.join(ENGINES.built_in)}, or one that another distribution adds",
    )
    minimal: Literal["cardinality", "subset"] = Field(
        default="subset",
        description="cardinality: the smallest diagnoses only; subset: all that have no smaller one in them",
    )
    max_size: int | None = Field(
        default=None, ge=0, le=100_000, description="of a diagnosis, in components; null: any"
    )
    limit: int = Field(default=100, ge=1, le=10_000, description="diagnoses that are looked for, at most")
    timeout_s: float | None = Field(
        default=None, gt=0, le=3600, description="of a diagnosis, in seconds; null: the service's own"
    )


class ExecutorBody(In):
    """Who carries out an action: what the kind needs is in `options`."""

    kind: str = Field(
        min_length=1,
        max_length=64,
        examples=["agent"],
        description="board, agent, process, webhook, or one that another distribution adds",
    )
    options: dict[Annotated[str, Field(max_length=64)], Any] = Field(
        default={}, max_length=32, description="what the kind needs"
    )


class ActionBody(In):
    """What differs for one action of the domain; null: as for the others."""

    policy: Literal["observe", "approve", "auto"] | None = Field(
        default=None, description="never do it, wait for a person, or just do it; null: as for the others"
    )
    executor: ExecutorBody | None = Field(
        default=None, description="who carries it out; null: the board, or an agent that can"
    )
    timeout_s: float | None = Field(
        default=None, gt=0, le=86400, description="for the executor's answer, in seconds; null: 10"
    )
    effect_timeout_s: float | None = Field(
        default=None,
        gt=0,
        le=86400,
        description="from the answer to its effect, at most, in seconds; null: 5",
    )
    retries: int | None = Field(
        default=None,
        ge=0,
        le=100,
        description="attempts after one that failed; null: 1, of your own actions 0",
    )
    idempotent: bool | None = Field(
        default=None,
        description="of your own action, whether it may be sent again when its outcome is unknown; null: no",
    )


class WindowBody(In):
    """A maintenance window in UTC; an end before the start is past midnight."""

    weekdays: list[Annotated[int, Field(ge=0, le=6)]] = Field(
        default=[0, 1, 2, 3, 4, 5, 6],
        min_length=1,
        max_length=7,
        description="on which it begins; 0 is Monday",
    )
    start: str = Field(
        pattern=r"^([01][0-9]|2[0-3]):[0-5][0-9]$", examples=["22:00"], description="HH:MM, in UTC"
    )
    end: str = Field(
        pattern=r"^([01][0-9]|2[0-3]):[0-5][0-9]$",
        examples=["05:30"],
        description="HH:MM, in UTC; before the start: of the next day",
    )


class RobotBody(In):
    """A robot: its model, how it is diagnosed, and what repair may do."""

    model: ModelName = Field(description="the model that the robot follows, by its name at the service")
    policy: Literal["observe", "approve", "auto"] = Field(
        default="approve", description="observe: never act; approve: a person says yes; auto: act"
    )
    limits: LimitsBody = Field(default_factory=LimitsBody, description="how much an automatic repair may try")
    allow: list[Annotated[str, Field(min_length=1, max_length=200)]] | None = Field(
        default=None, max_length=1000, description="names of actions that may run; null: all of the domain"
    )
    protected: list[Component] = Field(
        default=[],
        max_length=10_000,
        description="components that nothing shuts down or stops, besides the model's own",
    )
    board: BoardBody | None = Field(default=None, description="the robot's power board; null: it has none")
    expected: ExpectedBody = Field(default_factory=ExpectedBody, description="what is meant to be as it is")
    observed: list[Sentence] = Field(
        default=[], max_length=10_000, description="literals that the observers will report, with either sign"
    )
    observed_timeout_s: float = Field(
        default=30.0,
        gt=0,
        le=86400,
        description="how long an automatic repair waits until all of `observed` is known, in seconds",
    )
    detection_s: float = Field(
        default=2.5,
        ge=0,
        le=3600,
        description="from a change to the verdict of an observer that does not say so itself, in seconds",
    )
    hold_s: float = Field(
        default=0.0,
        ge=0,
        le=86400,
        description="how long a diagnosis must hold before an automatic repair, in seconds",
    )
    debounce_s: float = Field(
        default=0.0,
        ge=0,
        le=3600,
        description="OBS must be quiet for so many seconds before a diagnosis; at most ten times that",
    )
    period_s: float | None = Field(
        default=None,
        ge=0.05,
        le=86400,
        description="diagnose every so many seconds, changed or not; null: when something changed",
    )
    believe: list[Annotated[str, Field(min_length=1, max_length=200)]] = Field(
        default=[],
        max_length=100,
        description="sources of observations, in this order, that are believed where sources contradict each "
        "other",
    )
    bad_wins: bool = Field(
        default=False,
        description="what does not hold is believed where sources contradict each other and none of "
        "`believe` takes part; false: it is unknown then",
    )
    unknown: Literal["refuse", "keep"] = Field(
        default="refuse",
        description="what is done with names that the model does not declare: refused, or kept unused",
    )
    diagnosis: DiagnosisOptionsBody = Field(
        default_factory=DiagnosisOptionsBody, description="how far the engine searches"
    )
    planner: str = Field(
        default="pyperplan",
        max_length=64,
        examples=["pyperplan"],
        description=f"who plans: {', '.join(PLANNERS.built_in)}, or one that another distribution adds",
    )
    domain: str | None = Field(
        default=None, max_length=1 << 20, description="your own actions, in PDDL; null: none"
    )
    actions: dict[Annotated[str, Field(max_length=200)], ActionBody] = Field(
        default={}, max_length=1000, description="action → what differs for it"
    )
    windows: list[WindowBody] = Field(
        default=[], max_length=100, description="automatic repair only inside one of these; none: always"
    )


class AgentOut(Out):
    """What one of a robot's agents said of itself when it last asked for work."""

    agent: str
    host: str | None
    can: list[str] | None = Field(
        description="actions that it does, `name` or `name:parameter,parameter`; null: it does not say"
    )
    observes: list[str] = Field(description="what of the model its observers report")
    starved_ns: int | None = Field(
        default=None, description="since when its computer is starved: what comes late there is unknown"
    )
    starved: Moment | None = moment_of("starved_ns")


class RobotOut(Out):
    """A robot as it is configured, and how it is."""

    id: str
    config: RobotBody
    etag: str
    created_ns: int
    created: Moment = moment_of("created_ns")
    updated_ns: int
    updated: Moment = moment_of("updated_ns")
    revision: int = Field(description="of OBS; each accepted batch raises it")
    model_version: str | None = None
    healthy: bool | None = Field(
        default=None,
        description="`state` for programs; null: unknown, or in part unknown",
    )
    state: Literal["healthy", "unhealthy", "degraded", "partly-unknown", "unknown"] = Field(
        default="unknown", description="silence is not health: what should be observed and is not, is unknown"
    )
    headline: str = Field(
        default="",
        description="what is wrong since when, what follows, and what happens next or who is needed",
        examples=["hokuyo has no power since 23:23:04; scan and 4 more follow. Power up hokuyo?"],
    )
    unknown: list[str] = Field(default=[], description="what of `observed` is not known now")
    drill: DrillOut | None = Field(
        default=None, description="the drill that is open: what is planted, and how it is undone"
    )
    agents: list[AgentOut] = Field(
        default=[], description="agents that asked this instance for work within the last minute"
    )
    findings: list[str] = Field(
        default=[], description="what will not work or not be noticed as the robot is configured and observed"
    )


class RobotLine(Out):
    """A robot in the list of robots."""

    id: str
    model: str
    policy: str
    etag: str
    updated_ns: int
    updated: Moment = moment_of("updated_ns")
