"""The half of the transaction that the repair loop and the agents write: repairs, journal, memory, queue.

Everything the loop writes carries its fence. The robot's row is locked while the fence is compared, so a
take-over comes wholly before or wholly after the write.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sqlalchemy import or_, select, text

from robomend.errors import NotFound, StateConflict
from robomend.store import schema
from robomend.store.encoding import checked, checked_or_none, from_json, new_id, to_json
from robomend.store.records import (
    AgentAction,
    Fence,
    Intent,
    Json,
    Quarantine,
    RepairRequest,
    Stop,
    StoredAttempt,
    StoredRepair,
)
from robomend.store.repair_reading import agent_action_of, quarantine_of, repair_of, request_of
from robomend.store.transaction import SqlItem

_STOP_LOCK = 0x73746F70  # "stop": PostgreSQL's advisory lock; there may be no row to lock yet

HANDED_OUT_NS = 5_000_000_000
"""An action that its agent has not answered for so long is handed to any."""


class RepairWriting(SqlItem):
    """Changes of repairs, their journal and memory, and of the agents' queue."""

    # --- repairs

    def create_repair(
        self, robot: str, *, state: str, data: Json, open: bool = True, fence: Fence | None = None
    ) -> StoredRepair:
        self.existing(robot)
        if fence is not None:
            self._check_fence(robot, fence)
        id_, now = new_id("r-"), self.now_ns
        number = self._insert(
            schema.repairs,
            {
                "id": id_,
                "robot": robot,
                "state": checked(state),
                "open": open,
                "data": to_json(data),
                "created_ns": now,
                "updated_ns": now,
            },
        )
        return StoredRepair(id_, number, robot, state, open, data, now, now)

    def update_repair(self, repair: str, *, state: str, data: Json, open: bool, fence: Fence) -> StoredRepair:
        self._check_fence(self._robot_of(repair), fence)
        table = schema.repairs
        values = {"state": checked(state), "data": to_json(data), "open": open, "updated_ns": self.now_ns}
        self.change(table.update().where(table.c.id == repair), values)
        return self.repair(repair)

    def ask(self, repair: str, what: str, *, by: str, reason: str) -> RepairRequest:
        # Its owner writes intents under the same lock: one comes wholly before the request, or sees it.
        self.state(self._robot_of(repair))
        table = schema.repairs
        query = select(table).where(table.c.id == checked(repair)).with_for_update(read=True)
        asked = repair_of(self._one(query, f"repair {repair!r}"))
        if not asked.open:
            raise StateConflict(f"repair {repair} has ended: {asked.state}")
        request = RepairRequest(
            0, repair, asked.robot, checked(what), checked(by), checked(reason), self.now_ns
        )
        number = self._insert(
            schema.repair_requests,
            {
                "repair": repair,
                "robot": asked.robot,
                "what": what,
                "by": by,
                "reason": reason,
                "time_ns": self.now_ns,
                "done": False,
            },
        )
        return replace(request, number=number)

    def answer(self, request: int, *, fence: Fence) -> None:
        table = schema.repair_requests
        asked = request_of(self._one(select(table).where(table.c.number == request), f"request {request}"))
        self._check_fence(asked.robot, fence)
        self.change(table.update().where(table.c.number == request), {"done": True})

    def put_step(self, repair: str, step: int, *, state: str, data: Json, fence: Fence) -> None:
        self._check_fence(self._robot_of(repair), fence)
        row = {"repair": repair, "step": step, "state": checked(state), "data": to_json(data)}
        self.replace(schema.repair_steps, row | {"updated_ns": self.now_ns})

    def _robot_of(self, repair: str) -> str:
        table = schema.repairs
        query = select(table.c.robot).where(table.c.id == checked(repair))
        return str(self._one(query, f"repair {repair!r}").robot)

    # --- the action journal

    def stop(self) -> Stop:
        # Whoever sets the stop waits for those who have read that there is none and still write an intent.
        self.hold_stop("pg_advisory_xact_lock_shared")
        return super().stop()

    def hold_stop(self, lock: str) -> None:
        """Lock the global stop until the transaction ends; on SQLite one writes at a time anyway."""
        if self._group.kind == "postgresql":
            self._group.connection.execute(text(f"SELECT {lock}(:key)"), {"key": _STOP_LOCK})

    def intend(
        self,
        repair: str,
        step: int,
        *,
        action: str,
        name: str,
        parameters: Sequence[str],
        timeout_s: float,
        fence: Fence,
    ) -> Intent:
        robot = self._robot_of(repair)
        self._check_fence(robot, fence)
        table = schema.journal
        if self.rows(select(table.c.id).where(table.c.id == checked(action))):
            raise StateConflict(f"the action id {action} was used before; an id acts once")
        self._insert(
            table,
            {
                "id": action,
                "repair": repair,
                "step": step,
                "robot": robot,
                "name": checked(name),
                "parameters": to_json(list(parameters)),
                "timeout_s": timeout_s,
                "fence": fence.number,
                "intended_ns": self.now_ns,
                "message": "",
            },
        )
        return self.intent(action)

    def settle(self, action: str, code: int, message: str = "", *, fence: Fence) -> Intent:
        intent = self.intent(action)
        self._check_fence(intent.robot, fence)
        if intent.settled_ns is not None:
            return intent
        table = schema.journal
        outcome = {"code": code, "message": checked(message), "settled_ns": self.now_ns}
        self.change(table.update().where(table.c.id == action), outcome)
        return replace(intent, code=code, message=message, settled_ns=self.now_ns)

    # --- memory

    def remember(self, tried: StoredAttempt, *, fence: Fence) -> None:
        self._check_fence(tried.robot, fence)
        self._insert(
            schema.tried,
            {
                "robot": tried.robot,
                "bad": to_json(list(tried.bad)),
                "actions": to_json(list(tried.actions)),
                "helped": tried.helped,
                "effect_seen": tried.effect_seen,
                "repair": checked_or_none(tried.repair),
                "time_ns": tried.time_ns,
                "data": to_json(tried.data),
            },
        )

    def forget_tried(self, robot: str, component: str | None = None) -> int:
        table = schema.tried
        of_robot = table.c.robot == checked(robot)
        if component is None:
            return self.change(table.delete().where(of_robot))
        rows = self.rows(select(table.c.number, table.c.bad).where(of_robot))
        blamed = [row.number for row in rows if component in from_json(row.bad)]
        return self.change(table.delete().where(table.c.number.in_(blamed))) if blamed else 0

    def put_quarantine(self, entry: Quarantine, *, fence: Fence) -> None:
        self._check_fence(entry.robot, fence)
        self.replace(
            schema.quarantine,
            {
                "robot": entry.robot,
                "component": checked(entry.component),
                "reason": checked(entry.reason),
                "failures": entry.failures,
                "since_ns": entry.since_ns,
                "until_ns": entry.until_ns,
            },
        )

    def release_quarantine(self, robot: str, component: str) -> Quarantine:
        table = schema.quarantine
        of_component = (table.c.robot == checked(robot)) & (table.c.component == checked(component))
        row = self._first(select(table).where(of_component).with_for_update())
        if row is None:
            raise NotFound(f"component {component!r} of {robot!r} is not in quarantine")
        self.change(table.delete().where(of_component))
        return quarantine_of(row)

    def count_attempt(self, robot: str, component: str, repair: str, *, fence: Fence) -> None:
        self._check_fence(robot, fence)
        row = {"robot": robot, "component": checked(component), "repair": checked(repair)}
        self._insert(schema.attempts, row | {"time_ns": self.now_ns})

    # --- the agents' queue

    def queue_action(
        self,
        action: str,
        robot: str,
        *,
        host: str | None,
        name: str,
        parameters: Sequence[str],
        timeout_s: float,
    ) -> AgentAction:
        self.existing(robot)
        table = schema.agent_actions
        row = self._first(select(table).where(table.c.id == checked(action)))
        if row is not None:
            return agent_action_of(row)
        self._insert(
            table,
            {
                "id": action,
                "robot": robot,
                "host": checked_or_none(host),
                "name": checked(name),
                "parameters": to_json(list(parameters)),
                "timeout_s": timeout_s,
                "queued_ns": self.now_ns,
                "expires_ns": self.now_ns + int(timeout_s * 1e9),
                "answered": False,
                "message": "",
            },
        )
        return self.agent_action(action)

    def take_action(self, robot: str, *, host: str | None, agent: str) -> AgentAction | None:
        table, now = schema.agent_actions, self.now_ns
        query = (
            select(table)
            .where(
                table.c.robot == checked(robot),
                table.c.settled_ns.is_(None),
                ~table.c.answered,
                table.c.expires_ns > now,
                or_(table.c.host.is_(None), table.c.host == checked_or_none(host)),
                or_(
                    table.c.taken_by.is_(None),
                    table.c.taken_by == checked(agent),
                    table.c.taken_ns < now - HANDED_OUT_NS,
                ),
            )
            .order_by(table.c.number)
            .with_for_update(skip_locked=True)
        )
        row = self._first(query)
        if row is None:
            return None
        self.change(table.update().where(table.c.id == row.id), {"taken_by": agent, "taken_ns": now})
        return replace(agent_action_of(row), taken_by=agent, taken_ns=now)

    def answer_action(self, action: str) -> AgentAction:
        found = self._queued(action)
        if found.settled_ns is not None:
            raise StateConflict(f"action {action} has its result already")
        self.change(
            schema.agent_actions.update().where(schema.agent_actions.c.id == action), {"answered": True}
        )
        return replace(found, answered=True)

    def finish_action(self, action: str, code: int, message: str) -> AgentAction:
        found = self._queued(action)
        return found if found.settled_ns is not None else self._finish(found, code, message, answered=True)

    def withdraw_action(self, action: str, code: int, message: str) -> AgentAction:
        found = self._queued(action)
        if found.settled_ns is not None:
            return found
        if found.answered:
            raise StateConflict(f"action {action} is with an agent already; wait for its result")
        return self._finish(found, code, message, answered=False)

    def _queued(self, action: str) -> AgentAction:
        table = schema.agent_actions
        query = select(table).where(table.c.id == checked(action)).with_for_update()
        return agent_action_of(self._one(query, f"action {action!r}"))

    def _finish(self, found: AgentAction, code: int, message: str, *, answered: bool) -> AgentAction:
        table, now = schema.agent_actions, self.now_ns
        result = {"code": code, "message": checked(message), "settled_ns": now, "answered": answered}
        self.change(table.update().where(table.c.id == found.id), result)
        return replace(found, code=code, message=message, settled_ns=now, answered=answered)
