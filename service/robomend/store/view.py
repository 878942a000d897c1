"""View: what can be asked of a snapshot of the store; see interface.py."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from robomend.store.records import (
    AgentAction,
    ApiKey,
    AuditEntry,
    EventRange,
    Instance,
    Intent,
    Newest,
    Owner,
    Page,
    Paging,
    Quarantine,
    RepairRequest,
    SignIn,
    StepRecord,
    Stop,
    StoredAttempt,
    StoredBatch,
    StoredDiagnosis,
    StoredModel,
    StoredObs,
    StoredRepair,
    StoredRobot,
)
from robomend_client.events import Event

FIRST_PAGE = Paging()


class View(Protocol):
    """A consistent snapshot. Single things raise NotFound; a malformed cursor is an InputError."""

    # --- models and robots

    def model(self, name: str, version: str | None = None) -> StoredModel:
        """Return the current version of a model, or the one named."""
        ...

    def models(self, paging: Paging = FIRST_PAGE) -> Page[StoredModel]:
        """Return the current versions, by name."""
        ...

    def model_versions(self, name: str, paging: Paging = FIRST_PAGE) -> Page[StoredModel]:
        """Return all versions of a model, newest first."""
        ...

    def robot(self, robot: str) -> StoredRobot: ...

    def robots(self, paging: Paging = FIRST_PAGE, *, model: str | None = None) -> Page[StoredRobot]:
        """Return the robots by id, all or those that follow one model."""
        ...

    def newest(self, robot: str) -> Newest:
        """Return the versions of all that a robot's diagnosis rests on."""
        ...

    # --- observations and diagnoses

    def revision(self, robot: str) -> int:
        """Return how many batches were accepted; 0 for an unknown robot."""
        ...

    def obs(self, robot: str) -> StoredObs:
        """Return OBS now, expired entries included: freshness is judged by whoever reads it."""
        ...

    def history(self, robot: str, paging: Paging = FIRST_PAGE) -> Page[StoredBatch]:
        """Return the accepted batches, newest first."""
        ...

    def diagnosis(self, robot: str) -> StoredDiagnosis | None:
        """Return the latest diagnosis."""
        ...

    def diagnoses(self, robot: str, paging: Paging = FIRST_PAGE) -> Page[StoredDiagnosis]:
        """Return the diagnoses, newest first."""
        ...

    # --- events and audit

    def events(self, after: int, *, robot: str | None = None, limit: int = 500) -> tuple[Event, ...]:
        """Return up to `limit` events with a larger id than `after`, oldest first."""
        ...

    def event_range(self) -> EventRange:
        """Return which ids are kept; an id below `oldest - 1` has a gap behind it."""
        ...

    def audit(self, paging: Paging = FIRST_PAGE, *, robot: str | None = None) -> Page[AuditEntry]:
        """Return the audit log, newest first."""
        ...

    # --- repairs

    def repair(self, repair: str) -> StoredRepair: ...

    def repairs(
        self, robot: str | None = None, paging: Paging = FIRST_PAGE, *, open_only: bool = False
    ) -> Page[StoredRepair]:
        """Return repairs, newest first. The cursor may be a repair's id: those older than it."""
        ...

    def repair_requests(self, robot: str) -> tuple[RepairRequest, ...]:
        """Return what is asked of the robot's repairs and not done yet, oldest first."""
        ...

    def steps(self, repair: str) -> tuple[StepRecord, ...]:
        """Return the steps of a repair, in order."""
        ...

    def intents(self, repair: str) -> tuple[Intent, ...]:
        """Return the action journal of a repair, in the order of the intents."""
        ...

    def intent(self, action: str) -> Intent: ...

    def unsettled(self, robot: str) -> tuple[Intent, ...]:
        """Return the intents whose outcome is unknown: what a crash left behind."""
        ...

    def tried(self, robot: str, *, limit: int = 100) -> tuple[StoredAttempt, ...]:
        """Return the latest attempts, newest first."""
        ...

    def quarantine(self, robot: str) -> tuple[Quarantine, ...]:
        """Return the components in quarantine, by name, including those whose time is over."""
        ...

    def attempts(self, robot: str, since_ns: int) -> Mapping[str, int]:
        """Return component -> attempts counted since that time."""
        ...

    # --- agents, keys, stop, ownership

    def agent_action(self, action: str) -> AgentAction: ...

    def agent_actions(self, robot: str) -> tuple[AgentAction, ...]:
        """Return the actions without a result, in the order of queueing."""
        ...

    def keys(self) -> tuple[ApiKey, ...]:
        """Return all keys, revoked ones included, in the order of creation."""
        ...

    def key_with_hash(self, hash: str) -> ApiKey | None: ...

    def sign_in(self, hash: str) -> SignIn | None:
        """Return a sign-in with its key, which may be revoked; None if there is none or its time is over."""
        ...

    def stop(self) -> Stop:
        """Return the global stop."""
        ...

    def owner(self, robot: str) -> Owner | None: ...

    def instances(self) -> tuple[Instance, ...]: ...
