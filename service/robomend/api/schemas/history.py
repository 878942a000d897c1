"""What was: a robot's history, a kind at a time.

The lines go out as they are kept; these types describe them.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, RootModel

from robomend.api.schemas.base import Moment, Out, moment_of
from robomend.api.schemas.diagnosis import FaultOut, ResultOut
from robomend.api.schemas.observations import ReadingOut
from robomend.api.schemas.repair_record import RepairOut


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
