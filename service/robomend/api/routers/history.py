"""/history and /audit: what was, and who did what and why."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import Field, RootModel
from starlette.responses import Response

from robomend.api.deps import PartsDep, RobotPath, SpanDep
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.audit import AuditOut
from robomend.api.schemas.base import NAME, Items, Moment, Out, moment_of
from robomend.api.schemas.diagnosis import FaultOut, ResultOut
from robomend.api.schemas.observations import ReadingOut
from robomend.api.schemas.repair_record import RepairOut
from robomend.api.views import audit_json, history_text, page_text, response_of
from robomend.security import API
from robomend.store import View, audit

# --- what was: a robot's history, a kind at a time.
#
# The lines go out as they are kept; these types describe them.


class ReportedLiteral(Out):
    """A literal of a batch."""

    literal: str = Field(examples=["not ok(scan)"])
    source: str
    time_ns: int
    time: Moment = moment_of("time_ns")
    reading: ReadingOut | None = Field(None, description="what was measured")


class ReportedBatch(Out):
    """An accepted batch."""

    revision: int
    by: str = Field(description="the key that reported it; empty: nobody noted it")
    observations: list[ReportedLiteral]
    asserted: dict[str, str] = Field(description="name of an assertion -> its sentence")
    withdrawn: list[str] = Field(description="names of assertions")


class PastDiagnosis(Out):
    """A diagnosis that differed from the one before it."""

    revision: int = Field(description="of OBS")
    model_version: str
    result: ResultOut | None = Field(description="null: there is none; `fault` says why")
    fault: FaultOut | None
    expected_stopped: list[str] = Field(description="nodes that were meant to be stopped")
    drill: str | None = Field(description="the drill during which it was made", examples=["d-7k2m9x4q"])


class ObservationsLine(Out):
    """A batch came in."""

    kind: Literal["observations"]
    time_ns: int
    time: Moment = moment_of("time_ns")
    data: ReportedBatch


class DiagnosisLine(Out):
    """The diagnosis changed."""

    kind: Literal["diagnosis"]
    time_ns: int
    time: Moment = moment_of("time_ns")
    data: PastDiagnosis


class RepairLine(Out):
    """A repair began; `data` is how it is now."""

    kind: Literal["repair"]
    time_ns: int
    time: Moment = moment_of("time_ns")
    data: RepairOut


class HistoryLine(RootModel[ObservationsLine | DiagnosisLine | RepairLine]):
    """An entry of a robot's history: an accepted batch, a diagnosis or a repair; `kind` says which."""


router = APIRouter(prefix=API, tags=["history"], route_class=GuardedRoute)


@router.get("/robots/{robot}/history", response_model=Items[HistoryLine], responses=problems(404))
async def get_history(
    robot: RobotPath,
    parts: PartsDep,
    paging: SpanDep,
    kind: Literal["observations", "diagnosis", "repair"] = "observations",
) -> Response:
    """Return accepted batches, diagnoses or repairs over time, newest first."""
    return response_of(await history_text(parts.store, robot, kind, paging))


@router.get("/audit", response_model=Items[AuditOut], responses=problems())
async def get_audit(
    parts: PartsDep,
    paging: SpanDep,
    robot: Annotated[str | None, Query(pattern=NAME)] = None,
    actor: Annotated[str | None, Query(max_length=200, description="who did it")] = None,
    action: Annotated[
        str | None, Query(max_length=100, description="what was done", examples=["robot.put"])
    ] = None,
) -> Response:
    """Return the audit log, newest first, of everything or of one robot, actor or action."""

    def look(view: View) -> bytes:
        page = audit.page(view, paging, robot=robot, actor=actor, action=action)
        return page_text(map(audit_json, page.items), page.next)

    return response_of(await parts.store.read(look))
