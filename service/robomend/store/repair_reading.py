"""The half of the view that the repair loop asks: repairs, their journal, memory, and the agents' queue."""

from __future__ import annotations

from collections.abc import Mapping

from sqlalchemy import func, select

from robomend.store import schema
from robomend.store.encoding import checked, from_json
from robomend.store.records import (
    AgentAction,
    Intent,
    Page,
    Paging,
    Quarantine,
    RepairRequest,
    StepRecord,
    StoredAttempt,
    StoredRepair,
)
from robomend.store.snapshot import AnyRow, DatabaseSnapshot


class RepairReading(DatabaseSnapshot):
    """Questions about repairs."""

    def repair(self, repair: str) -> StoredRepair:
        table = schema.repairs
        return repair_of(self._one(select(table).where(table.c.id == checked(repair)), f"repair {repair!r}"))

    def repairs(
        self,
        robot: str | None = None,
        paging: Paging = Paging(),  # noqa: B008  # frozen
        *,
        open_only: bool = False,
    ) -> Page[StoredRepair]:
        table = schema.repairs
        where = [] if robot is None else [table.c.robot == checked(robot)]
        if open_only:
            where.append(table.c.open)
        if paging.cursor is not None and not paging.cursor.isdecimal():
            paging = Paging(str(self.repair(paging.cursor).number), paging.limit)
        return self._newest_first(table, repair_of, paging, *where)

    def repair_requests(self, robot: str) -> tuple[RepairRequest, ...]:
        table = schema.repair_requests
        query = select(table).where(table.c.robot == checked(robot), ~table.c.done).order_by(table.c.number)
        return tuple(request_of(row) for row in self.rows(query))

    def steps(self, repair: str) -> tuple[StepRecord, ...]:
        table = schema.repair_steps
        query = select(table).where(table.c.repair == checked(repair)).order_by(table.c.step)
        return tuple(
            StepRecord(row.repair, row.step, row.state, from_json(row.data), row.updated_ns)
            for row in self.rows(query)
        )

    def intents(self, repair: str) -> tuple[Intent, ...]:
        table = schema.journal
        query = select(table).where(table.c.repair == checked(repair)).order_by(table.c.number)
        return tuple(intent_of(row) for row in self.rows(query))

    def intent(self, action: str) -> Intent:
        table = schema.journal
        return intent_of(self._one(select(table).where(table.c.id == checked(action)), f"action {action!r}"))

    def unsettled(self, robot: str) -> tuple[Intent, ...]:
        table = schema.journal
        open_ones = table.c.settled_ns.is_(None)
        query = select(table).where(table.c.robot == checked(robot), open_ones).order_by(table.c.number)
        return tuple(intent_of(row) for row in self.rows(query))

    def tried(self, robot: str, *, limit: int = 100) -> tuple[StoredAttempt, ...]:
        table = schema.tried
        query = (
            select(table).where(table.c.robot == checked(robot)).order_by(table.c.number.desc()).limit(limit)
        )
        return tuple(
            StoredAttempt(
                robot=row.robot,
                bad=tuple(from_json(row.bad)),
                actions=tuple(from_json(row.actions)),
                helped=row.helped,
                effect_seen=row.effect_seen,
                repair=row.repair,
                time_ns=row.time_ns,
                data=from_json(row.data),
            )
            for row in self.rows(query)
        )

    def quarantine(self, robot: str) -> tuple[Quarantine, ...]:
        table = schema.quarantine
        query = select(table).where(table.c.robot == checked(robot)).order_by(table.c.component)
        return tuple(quarantine_of(row) for row in self.rows(query))

    def attempts(self, robot: str, since_ns: int) -> Mapping[str, int]:
        table = schema.attempts
        query = (
            select(table.c.component, func.count().label("attempts"))
            .where(table.c.robot == checked(robot), table.c.time_ns >= since_ns)
            .group_by(table.c.component)
        )
        return {row.component: row.attempts for row in self.rows(query)}

    def agent_action(self, action: str) -> AgentAction:
        table = schema.agent_actions
        query = select(table).where(table.c.id == checked(action))
        return agent_action_of(self._one(query, f"action {action!r}"))

    def agent_actions(self, robot: str) -> tuple[AgentAction, ...]:
        table = schema.agent_actions
        waiting = table.c.settled_ns.is_(None)
        query = select(table).where(table.c.robot == checked(robot), waiting).order_by(table.c.number)
        return tuple(agent_action_of(row) for row in self.rows(query))


def repair_of(row: AnyRow) -> StoredRepair:
    """Return the repair of a row."""
    return StoredRepair(
        row.id,
        row.number,
        row.robot,
        row.state,
        row.open,
        from_json(row.data),
        row.created_ns,
        row.updated_ns,
    )


def request_of(row: AnyRow) -> RepairRequest:
    """Return the request of a row."""
    return RepairRequest(
        row.number, row.repair, row.robot, row.what, row.by, row.reason, row.time_ns, row.done
    )


def quarantine_of(row: AnyRow) -> Quarantine:
    """Return the quarantine entry of a row."""
    return Quarantine(row.robot, row.component, row.reason, row.failures, row.since_ns, row.until_ns)


def intent_of(row: AnyRow) -> Intent:
    """Return the journal entry of a row."""
    return Intent(
        id=row.id,
        repair=row.repair,
        step=row.step,
        robot=row.robot,
        name=row.name,
        parameters=tuple(from_json(row.parameters)),
        timeout_s=row.timeout_s,
        fence=row.fence,
        intended_ns=row.intended_ns,
        code=row.code,
        message=row.message,
        settled_ns=row.settled_ns,
    )


def agent_action_of(row: AnyRow) -> AgentAction:
    """Return the queued action of a row."""
    return AgentAction(
        id=row.id,
        robot=row.robot,
        host=row.host,
        name=row.name,
        parameters=tuple(from_json(row.parameters)),
        timeout_s=row.timeout_s,
        queued_ns=row.queued_ns,
        expires_ns=row.expires_ns,
        taken_by=row.taken_by,
        taken_ns=row.taken_ns,
        answered=row.answered,
        code=row.code,
        message=row.message,
        settled_ns=row.settled_ns,
    )
