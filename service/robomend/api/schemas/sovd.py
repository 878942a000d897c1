"""What tools for SOVD and ros2_medkit read: entities, faults, operations and their executions."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import Component, In, Out, Reason
from robomend.repairs.states import RepairState


class SovdEntity(Out):
    """A component of the robot's model."""

    id: str = Field(examples=["hokuyo"])
    name: str = Field(examples=["hokuyo"])
    href: str = Field(examples=["/api/v1/robots/tedusar-1/sovd/components/hokuyo"])


class SovdFault(Out):
    """A component that diagnoses blame."""

    fault_code: str = Field(examples=["BAD:hokuyo"])
    severity: int = Field(description="2: bad in every diagnosis; 1: in some", examples=[2])
    severity_label: Literal["WARN", "ERROR"]
    description: str = Field(examples=["hokuyo explains not ok(scan)"])
    status: Literal["PREFAILED", "CONFIRMED"]
    reporting_sources: list[str] = Field(examples=[["hokuyo"]])
    last_occurred: float = Field(description="seconds since 1970", examples=[1764000000.5])


class SovdOperation(Out):
    """What can be asked for."""

    id: str = Field(examples=["repair"])
    name: str = Field(examples=["repair"])
    asynchronous_execution: bool


class SovdExecution(Out):
    """A repair."""

    id: str = Field(examples=["r-7k2m9x4q"])
    status: Literal["pending", "running", "completed", "failed"]
    state: RepairState = Field(alias="x-robomend-state", description="the repair's own state")


class SovdRepairParameters(In):
    """Which repair."""

    bad: list[Component] | None = Field(
        default=None, max_length=10_000, description="null: choose among the diagnoses"
    )
    reason: Reason = ""


class SovdExecutionBody(In):
    """Ask for a repair; `{}` will do."""

    parameters: SovdRepairParameters = Field(default_factory=SovdRepairParameters)
