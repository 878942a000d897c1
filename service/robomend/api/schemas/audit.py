"""The audit log's entries: who did what and why, and by the action what was before and after it.

The log's JSON goes out as it is kept; these types describe it. An action that is not here has no details.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field, RootModel

from robomend.api.schemas.base import Moment, Out, moment_of
from robomend.api.schemas.repair_record import BadAndGood
from robomend.api.schemas.robots import RobotBody
from robomend.drills.record import DrillState
from robomend.repairs.states import RepairState


def _one_of(*actions: str) -> Any:
    """Return the field of an entry's action, which is one of these."""
    return Field(json_schema_extra={"enum": list(actions)}, examples=[actions[0]])


class AuditLine(Out):
    """What every entry has."""

    id: int
    time_ns: int
    time: Moment = moment_of("time_ns")
    actor: str = Field(description="the name of a key, or who else")
    subject: str
    robot: str | None
    reason: str


class PlainAudited(AuditLine):
    """An action without details."""

    action: str = _one_of(
        "channel.on",
        "channel.off",
        "component.quarantined",
        "quarantine.release",
        "session.begin",
        "session.end",
        "notification.test",
    )
    before: None
    after: None


class RobotAudited(AuditLine):
    """A robot's configuration, secrets covered."""

    action: str = _one_of("robot.put", "robot.delete")
    before: RobotBody | None = Field(description="null: it was new")
    after: RobotBody | None = Field(description="null: it is deleted")


class AuditedModel(Out):
    """The version of a model."""

    version: str


class ModelAudited(AuditLine):
    """A model."""

    action: str = _one_of("model.put", "model.delete")
    before: None
    after: AuditedModel | None


class AuditedRequest(Out):
    """What was to be repaired."""

    bad: list[str] | None = Field(description="null: the best choice")


class RepairAsked(AuditLine):
    """A repair begins."""

    action: str = _one_of("repair.create")
    before: None
    after: AuditedRequest | None = Field(description="null: nobody asked, the diagnosis is not healthy")


class AuditedState(Out):
    """The state before."""

    state: str


class AuditedRepair(Out):
    """A repair as it went on."""

    state: RepairState
    diagnosis: BadAndGood | None
    round: int | None


class RepairAudited(AuditLine):
    """A repair comes to a state, or somebody asks it to."""

    action: str = _one_of("repair.approve", "repair.cancel", *(f"repair.{state}" for state in RepairState))
    before: AuditedState | None
    after: AuditedRepair | None


class AuditedPreconditions(Out):
    """What had to hold."""

    preconditions: list[str]


class AuditedEffects(Out):
    """What is to hold after it."""

    effects: list[str]


class ActionSent(AuditLine):
    """An action is sent."""

    action: str = _one_of("action.sent")
    before: AuditedPreconditions
    after: AuditedEffects


class AuditedResult(Out):
    """How an action ended."""

    result: int = Field(description="0 is success")


class ActionEnded(AuditLine):
    """An action has ended."""

    action: str = _one_of("action.result")
    before: None
    after: AuditedResult


class AuditedReport(Out):
    """What an agent took or reported."""

    action: str = Field(description="its id", examples=["r-7k2m9x4q:2"])
    host: str | None
    result: int | None
    in_place_of_the_robot: bool = Field(description="with a key that is not the robot's own")


class ActionReported(AuditLine):
    """An agent takes an action, or reports how it ended."""

    action: str = _one_of("action.taken", "action.reported")
    before: None
    after: AuditedReport


class AuditedObservations(Out):
    """The first observations of a batch."""

    revision: int
    observations: list[str]
    of: int | None = Field(default=None, description="how many there are, where they are not all here")
    in_place_of_the_robot: bool = Field(description="with a key that is not the robot's own")


class ObservationsReported(AuditLine):
    """Observations come in; a source that reports all the time is here now and then."""

    action: str = _one_of("observations.report")
    before: None
    after: AuditedObservations


class AuditedAssertion(Out):
    """An assertion, put or withdrawn."""

    revision: int
    sentence: str | None = Field(default=None, description="missing: it is withdrawn")
    source: str | None = None


class AssertionAudited(AuditLine):
    """A named sentence is said or withdrawn."""

    action: str = _one_of("assertion.put", "assertion.withdraw")
    before: None
    after: AuditedAssertion


class AuditedBatch(Out):
    """What of a batch is new."""

    model: str | None = None
    logs: int | None = Field(default=None, description="files")
    bytes: int | None = Field(default=None, description="of an upload")
    message: str | None = None
    log_states: dict[str, int] | None = None


class BatchAudited(AuditLine):
    """A batch of logs begins, or comes to a state."""

    action: str = _one_of(
        "batch.create", "batch.started", "batch.interrupted", "batch.done", "batch.failed", "batch.cancel"
    )
    before: None
    after: AuditedBatch | None


class AuditedFault(Out):
    """What is to be planted."""

    fault: str


class DrillAsked(AuditLine):
    """A drill begins."""

    action: str = _one_of("drill.create")
    before: None
    after: AuditedFault


class AuditedDrill(Out):
    """A drill as it went on."""

    state: DrillState
    fault: str
    undo: str


class DrillAudited(AuditLine):
    """A drill comes to a state, or somebody asks it to."""

    action: str = _one_of(
        "drill.cancel", "drill.abandon", *(f"drill.{state}" for state in DrillState)
    )  # `drill.done` is said by a person, too
    before: AuditedState | None
    after: AuditedDrill | None


class AuditedKey(Out):
    """A key."""

    id: str
    role: str
    robot: str | None


class KeyAudited(AuditLine):
    """A key is created or revoked."""

    action: str = _one_of("key.create", "key.revoke")
    before: None
    after: AuditedKey


class AuditedStop(Out):
    """When it was asked for."""

    asked_ns: int
    asked: Moment = moment_of("asked_ns")


class StopAudited(AuditLine):
    """The global stop."""

    action: str = _one_of("stop.set", "stop.lifted")
    before: None
    after: AuditedStop | None = Field(description="where it was on disk only later than it was asked for")


class AuditedFailure(Out):
    """Why a channel was not switched."""

    error: str


class ChannelFailed(AuditLine):
    """A channel was not switched."""

    action: str = _one_of("channel.on.failed", "channel.off.failed")
    before: None
    after: AuditedFailure


class AuditOut(
    RootModel[
        PlainAudited
        | RobotAudited
        | ModelAudited
        | RepairAsked
        | RepairAudited
        | ActionSent
        | ActionEnded
        | ActionReported
        | ObservationsReported
        | AssertionAudited
        | BatchAudited
        | DrillAsked
        | DrillAudited
        | KeyAudited
        | StopAudited
        | ChannelFailed
    ]
):
    """Who did what to what, and why; `action` says what `before` and `after` are."""
