"""The repair loop as the routers see it, with answers made up: it repairs nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping, Sequence
from typing import Any, cast

from robomend.errors import NotFound, StateConflict
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.executors.registry import Surroundings, check
from robomend.repairs.repair_json import repair_json
from robomend.repairs.stop_switch import StopSwitch
from robomend.robots.reporters import Reporter
from robomend.store import Store
from robomend.store.records import Json, Quarantine, StoredRepair

STORED = StoredRepair("r-1", 1, "r1", "awaiting-approval", True, {"plan": [], "by": "local"}, 1, 2)
REPAIR = repair_json(STORED)


class RepairsDouble:
    """Stands in for robomend.repairs.repairs.Repairs."""

    def __init__(self, store: Store) -> None:
        self.switch = StopSwitch(store)
        self.agents = AgentQueue(store)
        self.queue: dict[str, Json] = {}
        self.owners: dict[str, str] = {}
        self.first: dict[str, Json] = {}

    async def start(self) -> None:
        await self.switch.start()

    async def close(self) -> None:
        await self.switch.close()

    def end_waits(self) -> None:
        pass

    def check_actions(self, robot: str, configured: Mapping[str, Mapping[str, Any]]) -> None:
        around = Surroundings(robot, None, cast(AgentQueue, None), {}, {}, (), asyncio.Event())
        check(configured, around)

    async def plan(
        self, robot: str, *, bad: Sequence[str] | None, planner: str | None, timeout_s: float, pddl: bool
    ) -> Json:
        chosen = {"bad": list(bad or []), "good": [], "probability": None, "weight": None}
        answer: Json = {"choice": chosen, "plan": None, "alternatives": [], "probe": None}
        return {**answer, "expected_cost": 0.0, "reason": "nothing is to be done"}

    async def findings(self, robot: str) -> Sequence[str]:
        return [f"nobody looks at {robot}"]

    async def create(self, robot: str, *, bad: Sequence[str] | None, by: str, reason: str) -> Json:
        if robot != "r1":
            raise StateConflict(f"a repair of {robot!r} is open")
        return REPAIR

    async def repairs(
        self, robot: str, *, before: str | None, limit: int, **_: str | int | None
    ) -> Sequence[Json]:
        return [REPAIR]

    async def repair(self, repair_id: str) -> Json:
        if repair_id not in {"r-1", "c-1"}:  # a change is decided on as a repair is
            raise NotFound(f"there is no repair {repair_id!r}")
        return REPAIR

    async def approve(self, repair_id: str, *, by: str, reason: str) -> Json:
        return {**await self.repair(repair_id), "state": "running"}

    async def cancel(self, repair_id: str, *, by: str, reason: str) -> Json:
        return {**await self.repair(repair_id), "state": "cancelled"}

    async def orders(
        self,
        robot: str,
        *,
        host: str | None,
        wait_s: float,
        by: Reporter,
        agent: str | None = None,
        can: Collection[str] | None = None,
        **said: object,
    ) -> Json | None:
        if robot not in self.queue and wait_s:
            await asyncio.sleep(min(wait_s, 0.05))  # a long poll of an empty queue
        return self.queue.get(robot)

    async def action_robot(self, action_id: str) -> str:
        if action_id not in self.owners:
            raise NotFound(f"there is no action {action_id!r}")
        return self.owners[action_id]

    async def feedback(self, action_id: str, *, code: int, message: str) -> None:
        await self.action_robot(action_id)

    async def result(self, action_id: str, *, code: int, message: str, by: Reporter) -> Json:
        await self.action_robot(action_id)
        return self.first.setdefault(action_id, {"code": code, "message": message})

    async def quarantined(self, robot: str) -> Mapping[str, Quarantine]:
        return {"jaguar": Quarantine(robot, "jaguar", "three attempts did not help", 3, 0, None)}

    async def release(self, robot: str, component: str, *, by: str, reason: str) -> None:
        if component != "jaguar":
            raise NotFound(f"{component!r} is not in quarantine")
