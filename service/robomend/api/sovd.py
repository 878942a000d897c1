"""A robot in the shape of SOVD, as ros2_medkit's gateways have it: diagnoses are faults, repairs executions.

| SOVD                               | here                                                       |
| component                          | a component of the model                                   |
| fault, ERROR and CONFIRMED         | bad in every diagnosis, and all of them are known          |
| fault, WARN and PREFAILED          | bad in some                                                |
| execution of the operation repair  | a repair: pending, running, completed (seen to help), failed |
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robomend.api.schemas.sovd import SovdEntity, SovdExecution, SovdFault, SovdOperation
from robomend.repairs.states import RepairState
from robomend.security import API

REPAIR = "repair"
"""The one operation."""

OPERATION = SovdOperation(id=REPAIR, name=REPAIR, asynchronous_execution=True)

STATUS = {
    RepairState.WAITING: "pending",
    RepairState.PLANNING: "pending",
    RepairState.AWAITING_APPROVAL: "pending",
    RepairState.RUNNING: "running",
    RepairState.VERIFYING: "running",
    RepairState.REPAIRED: "completed",
    RepairState.UNCONFIRMED: "failed",
    RepairState.ESCALATED: "failed",
    RepairState.CANCELLED: "failed",
    RepairState.FAILED: "failed",
}


def root(robot: str) -> str:
    return f"{API}/robots/{robot}/sovd"


def entities(robot: str, result: Mapping[str, Any]) -> list[SovdEntity]:
    """Return all components that the diagnoses speak of."""
    names = sorted({name for one in result["diagnoses"] for name in (*one["bad"], *one["good"])})
    return [SovdEntity(id=name, name=name, href=f"{root(robot)}/components/{name}") for name in names]


def faults(result: Mapping[str, Any], time_ns: int) -> list[SovdFault]:
    """Return the components that any diagnosis blames."""
    diagnoses = result["diagnoses"]
    found = []
    for name in sorted({name for one in diagnoses for name in one["bad"]}):
        blaming = [one for one in diagnoses if name in one["bad"]]
        certain = len(blaming) == len(diagnoses) and result.get("complete", False)
        found.append(
            SovdFault(
                fault_code=f"BAD:{name}",
                severity=2 if certain else 1,
                severity_label="ERROR" if certain else "WARN",
                description=blaming[0].get("text") or ", ".join(blaming[0]["bad"]),
                status="CONFIRMED" if certain else "PREFAILED",
                reporting_sources=[name],
                last_occurred=time_ns / 1e9,
            )
        )
    return found


def execution(repair: Mapping[str, Any]) -> SovdExecution:
    """Return a repair as an execution."""
    state = RepairState(repair["state"])
    return SovdExecution.model_validate(
        {"id": repair["id"], "status": STATUS[state], "x-robomend-state": state}
    )
