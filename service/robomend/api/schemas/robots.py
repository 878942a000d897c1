"""What is configured of a robot."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from robomend.api.schemas.base import Component, In, ModelName, Moment, Out, Sentence, moment_of
from robomend.api.schemas.drill import DrillOut


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
    control_port: int | None = Field(
        default=None, ge=1, le=65535, description="of an emulated board: drills plant its faults there"
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

    kind: str = Field(
        min_length=1,
        max_length=64,
        examples=["agent"],
        description="board, agent, process, webhook, or one that another distribution adds",
    )
    options: dict[Annotated[str, Field(max_length=64)], Any] = Field(default={}, max_length=32)


class ActionBody(In):
    """What differs for one action of the domain; null: as for the others."""

    policy: Literal["observe", "approve", "auto"] | None = None
    executor: ExecutorBody | None = None
    timeout_s: float | None = Field(default=None, gt=0, le=86400, description="for the executor's answer")
    effect_timeout_s: float | None = Field(
        default=None, gt=0, le=86400, description="from the answer to its effect, at most"
    )
    retries: int | None = Field(default=None, ge=0, le=100)
    idempotent: bool | None = Field(
        default=None,
        description="of a user's action: whether it may be sent again when its outcome is unknown",
    )


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
    detection_s: float = Field(
        default=2.5,
        ge=0,
        le=3600,
        description="what an observer that does not say so itself needs from a change to its verdict",
    )
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


class AgentOut(Out):
    """What one of a robot's agents said of itself when it last asked for work."""

    agent: str
    host: str | None
    can: list[str] | None = Field(
        description="actions that it does, `name` or `name:parameter,parameter`; null: it does not say"
    )
    observes: list[str] = Field(description="what of the model its observers report")


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
    state: Literal["healthy", "unhealthy", "partly-unknown", "unknown"] = Field(
        default="unknown", description="silence is not health: what should be observed and is not, is unknown"
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
