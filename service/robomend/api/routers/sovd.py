"""/robots/{robot}/sovd: a robot for tools that read SOVD and ros2_medkit.

| SOVD                               | here                                                         |
| ---------------------------------- | ------------------------------------------------------------ |
| component                          | a component of the model                                     |
| fault, ERROR and CONFIRMED         | bad in every diagnosis, and all of them are known            |
| fault, WARN and PREFAILED          | bad in some                                                  |
| execution of the operation repair  | a repair: pending, running, completed (seen to help), failed |
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Response
from pydantic import Field

from robomend.api.deps import Parts, PartsDep, PrincipalDep, RepairPath, RobotPath
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import Component, In, Items, Out, Reason
from robomend.errors import NotFound, StateConflict
from robomend.repairs.states import RepairState
from robomend.security import API

# --- what tools for SOVD and ros2_medkit read: entities, faults, operations and their executions.


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


MOST_EXECUTIONS = 100

ComponentPath = Annotated[Component, Path(description="a component's name", examples=["jaguar"])]

router = APIRouter(prefix=f"{API}/robots/{{robot}}/sovd", tags=["sovd"], route_class=GuardedRoute)


@router.get("/components", responses=problems(404, 409))
async def list_sovd_components(robot: RobotPath, parts: PartsDep) -> Items[SovdEntity]:
    """List the robot's components; a conflict while there is no diagnosis."""
    result, _ = await _diagnosis(parts, robot)
    return Items(items=entities(robot, result))


@router.get("/apps", responses=problems(404))
async def list_sovd_apps(robot: RobotPath, parts: PartsDep) -> Items[SovdEntity]:
    """List nothing: nodes are components, too."""
    await parts.robots.diagnosed(robot)
    return Items(items=[])


@router.get("/faults", responses=problems(404, 409))
async def list_sovd_faults(robot: RobotPath, parts: PartsDep) -> Items[SovdFault]:
    """List the components that the diagnoses blame; a conflict while there is no diagnosis."""
    return Items(items=faults(*await _diagnosis(parts, robot)))


@router.get("/components/{component}/faults", responses=problems(404, 409))
async def list_sovd_faults_of_component(
    robot: RobotPath, component: ComponentPath, parts: PartsDep
) -> Items[SovdFault]:
    """List the fault of one component, if it is blamed."""
    result, time_ns = await _diagnosis(parts, robot)
    if component not in (entity.id for entity in entities(robot, result)):
        raise NotFound(f"robot {robot} has no component {component!r}")
    found = faults(result, time_ns)
    return Items(items=[fault for fault in found if fault.reporting_sources == [component]])


@router.get("/operations", responses=problems(404))
async def list_sovd_operations(robot: RobotPath, parts: PartsDep) -> Items[SovdOperation]:
    """List what can be asked for: a repair."""
    await parts.robots.diagnosed(robot)
    return Items(items=[OPERATION])


@router.post("/operations/repair/executions", status_code=202, responses=problems(404, 409, body=True))
async def create_sovd_execution(
    robot: RobotPath,
    body: SovdExecutionBody,
    parts: PartsDep,
    principal: PrincipalDep,
    response: Response,
) -> SovdExecution:
    """Ask for a repair, under the robot's policy like any other; a conflict while one is open."""
    wanted = body.parameters
    repair = await parts.repairs.create(robot, bad=wanted.bad, by=principal.name, reason=wanted.reason)
    response.headers["Location"] = f"{root(robot)}/operations/repair/executions/{repair['id']}"
    return execution(repair)


@router.get("/operations/repair/executions", responses=problems(404))
async def list_sovd_executions(robot: RobotPath, parts: PartsDep) -> Items[SovdExecution]:
    """List the robot's newest repairs."""
    found = await parts.repairs.repairs(robot, before=None, limit=MOST_EXECUTIONS)
    return Items(items=[execution(repair) for repair in found])


@router.get("/operations/repair/executions/{repair}", responses=problems(404))
async def get_sovd_execution(robot: RobotPath, repair: RepairPath, parts: PartsDep) -> SovdExecution:
    """Return one repair of this robot."""
    found = await parts.repairs.repair(repair)
    if found["robot"] != robot:
        raise NotFound(f"robot {robot} has no repair {repair!r}")
    return execution(found)


async def _diagnosis(parts: Parts, robot: str) -> tuple[Mapping[str, Any], int]:
    current = (await parts.robots.diagnosed(robot)).current
    if current is None or current.result is None:
        raise StateConflict(f"robot {robot} has no diagnosis now: that nothing is blamed would not be known")
    return current.result, current.time_ns
