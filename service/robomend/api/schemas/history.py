"""What was, and who did what and why."""

from __future__ import annotations

from typing import Any, Literal

from robomend.api.schemas.base import Moment, Out, moment_of


class AuditOut(Out):
    """Who did what to what, and why."""

    id: int
    time_ns: int
    time: Moment = moment_of("time_ns")
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
    time: Moment = moment_of("time_ns")
    data: dict[str, Any]
