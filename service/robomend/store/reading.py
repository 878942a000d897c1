"""View: questions to one snapshot. RepairReading has the half that only the repair loop asks."""

from __future__ import annotations

import time

from sqlalchemy import func, select

from robomend.entry import Entry
from robomend.store import schema
from robomend.store.encoding import atom_from_text, batch_from_text, checked, from_json
from robomend.store.records import (
    ApiKey,
    AuditEntry,
    EventRange,
    Instance,
    Newest,
    Owner,
    Page,
    Paging,
    SignIn,
    Stop,
    StoredAssertion,
    StoredBatch,
    StoredDiagnosis,
    StoredModel,
    StoredObs,
    StoredRobot,
)
from robomend.store.repair_reading import RepairReading
from robomend.store.snapshot import AnyRow, limit_of, page_of
from robomend_client.events import Event, Kind
from robomend_client.literals import Literal

_NEWEST = (
    select(schema.robot_state.c.revision, schema.robots.c.etag, schema.model_versions.c.version)
    .join_from(schema.robots, schema.robot_state, schema.robot_state.c.robot == schema.robots.c.id)
    .outerjoin(schema.models, schema.models.c.name == schema.robots.c.model)
    .outerjoin(
        schema.model_versions,
        (schema.model_versions.c.name == schema.models.c.name)
        & (schema.model_versions.c.number == schema.models.c.current),
    )
)


class SqlView(RepairReading):
    """robomend.store.interface.View on a connection that is in a transaction."""

    # --- models and robots

    def model(self, name: str, version: str | None = None) -> StoredModel:
        table, models = schema.model_versions, schema.models
        query = select(table).where(table.c.name == checked(name))
        if version is None:
            current = (models.c.name == table.c.name) & (models.c.current == table.c.number)
            return _model(self._one(query.join(models, current), f"model {name!r}"))
        query = query.where(table.c.version == checked(version)).order_by(table.c.number.desc())
        return _model(self._one(query, f"version {version!r} of a model {name!r}"))

    def models(self, paging: Paging = Paging()) -> Page[StoredModel]:  # noqa: B008  # frozen
        table, models = schema.model_versions, schema.models
        current = (models.c.name == table.c.name) & (models.c.current == table.c.number)
        query = select(table).join(models, current).order_by(table.c.name).limit(limit_of(paging) + 1)
        if paging.cursor is not None:
            query = query.where(table.c.name > checked(paging.cursor))
        return page_of(self.rows(query), paging, _model, lambda row: str(row.name))

    def model_versions(self, name: str, paging: Paging = Paging()) -> Page[StoredModel]:  # noqa: B008  # frozen
        self.model(name)
        table = schema.model_versions
        return self._newest_first(table, _model, paging, table.c.name == name)

    def robot(self, robot: str) -> StoredRobot:
        table = schema.robots
        return robot_of(self._one(select(table).where(table.c.id == checked(robot)), f"robot {robot!r}"))

    def robots(
        self,
        paging: Paging = Paging(),  # noqa: B008  # frozen
        *,
        model: str | None = None,
    ) -> Page[StoredRobot]:
        table = schema.robots
        query = select(table).order_by(table.c.id).limit(limit_of(paging) + 1)
        if model is not None:
            query = query.where(table.c.model == checked(model))
        if paging.cursor is not None:
            query = query.where(table.c.id > checked(paging.cursor))
        return page_of(self.rows(query), paging, robot_of, lambda row: str(row.id))

    def newest(self, robot: str) -> Newest:
        row = self._one(_NEWEST.where(schema.robots.c.id == checked(robot)), f"robot {robot!r}")
        return Newest(row.revision, row.etag, row.version)

    # --- observations and diagnoses

    def revision(self, robot: str) -> int:
        table = schema.robot_state
        row = self._first(select(table.c.revision).where(table.c.robot == checked(robot)))
        return 0 if row is None else int(row.revision)

    def obs(self, robot: str) -> StoredObs:
        revision = self.revision(robot)
        entries, assertions = schema.obs, schema.assertions
        return StoredObs(
            revision,
            tuple(
                Entry(
                    Literal(atom_from_text(row.atom), row.positive), row.source, row.time_ns, row.expires_ns
                )
                for row in self.rows(select(entries).where(entries.c.robot == robot).order_by(entries.c.atom))
            ),
            tuple(
                StoredAssertion(row.name, row.sentence, row.source, row.time_ns, row.expires_ns)
                for row in self.rows(
                    select(assertions).where(assertions.c.robot == robot).order_by(assertions.c.name)
                )
            ),
        )

    def history(self, robot: str, paging: Paging = Paging()) -> Page[StoredBatch]:  # noqa: B008  # frozen
        table = schema.observations
        of_robot = table.c.robot == checked(robot)
        return self._newest_first(table, _accepted, paging, of_robot, key="revision")

    def diagnosis(self, robot: str) -> StoredDiagnosis | None:
        table = schema.diagnoses
        query = select(table).where(table.c.robot == checked(robot)).order_by(table.c.number.desc())
        row = self._first(query)
        return None if row is None else _diagnosed(row)

    def diagnoses(self, robot: str, paging: Paging = Paging()) -> Page[StoredDiagnosis]:  # noqa: B008  # frozen
        table = schema.diagnoses
        return self._newest_first(table, _diagnosed, paging, table.c.robot == checked(robot))

    # --- events and audit

    def events(self, after: int, *, robot: str | None = None, limit: int = 500) -> tuple[Event, ...]:
        table = schema.events
        query = select(table).where(table.c.id > after).order_by(table.c.id).limit(limit)
        if robot is not None:
            query = query.where(table.c.robot == checked(robot))
        return tuple(event_of(row) for row in self.rows(query))

    def event_range(self) -> EventRange:
        counters = schema.counters
        newest = self._one(select(counters.c.value).where(counters.c.name == "event"), "event counter").value
        oldest = self.rows(select(func.min(schema.events.c.id)))[0][0]
        return EventRange(oldest=newest + 1 if oldest is None else oldest, newest=newest)

    def audit(self, paging: Paging = Paging(), *, robot: str | None = None) -> Page[AuditEntry]:  # noqa: B008  # frozen
        table = schema.audit
        where = () if robot is None else (table.c.robot == checked(robot),)
        return self._newest_first(table, _audit_entry, paging, *where, key="id")

    # --- keys, stop, ownership

    def keys(self) -> tuple[ApiKey, ...]:
        table = schema.api_keys
        return tuple(key_of(row) for row in self.rows(select(table).order_by(table.c.number)))

    def key_with_hash(self, hash: str) -> ApiKey | None:
        table = schema.api_keys
        row = self._first(select(table).where(table.c.hash == checked(hash)))
        return None if row is None else key_of(row)

    def sign_in(self, hash: str) -> SignIn | None:
        table, keys = schema.sign_ins, schema.api_keys
        until = table.c.expires_ns.label("until_ns")
        since = table.c.created_ns.label("since_ns")
        query = select(keys, since, until).join(table, table.c.key == keys.c.id)
        row = self._first(query.where(table.c.hash == checked(hash), table.c.expires_ns > time.time_ns()))
        return None if row is None else SignIn(hash, key_of(row), row.since_ns, row.until_ns)

    def stop(self) -> Stop:
        table = schema.settings
        row = self._first(select(table.c.value).where(table.c.name == "stop"))
        return Stop() if row is None else Stop(**from_json(row.value))

    def owner(self, robot: str) -> Owner | None:
        table = schema.robot_state
        row = self._first(select(table).where(table.c.robot == checked(robot)))
        return None if row is None else Owner(row.robot, row.owner, row.fence)

    def instances(self) -> tuple[Instance, ...]:
        table = schema.instances
        rows = self.rows(select(table).order_by(table.c.id))
        return tuple(Instance(row.id, row.host, row.pid, row.started_ns, row.heartbeat_ns) for row in rows)


def robot_of(row: AnyRow) -> StoredRobot:
    """Return the robot of a row."""
    return StoredRobot(row.id, from_json(row.config), row.etag, row.created_ns, row.updated_ns)


def event_of(row: AnyRow) -> Event:
    """Return the event of a row."""
    return Event(row.id, row.time_ns, Kind(row.kind), row.robot, from_json(row.data))


def key_of(row: AnyRow) -> ApiKey:
    """Return the key of a row."""
    return ApiKey(row.id, row.name, row.hash, row.role, row.robot, row.created_ns, row.by, row.revoked_ns)


def _model(row: AnyRow) -> StoredModel:
    return StoredModel(row.name, row.version, row.number, row.format, row.source, row.created_ns, row.by)


def _accepted(row: AnyRow) -> StoredBatch:
    return StoredBatch(row.robot, row.revision, row.time_ns, *batch_from_text(row.data))


def _diagnosed(row: AnyRow) -> StoredDiagnosis:
    return StoredDiagnosis(row.robot, row.revision, row.model_version, row.time_ns, from_json(row.result))


def _audit_entry(row: AnyRow) -> AuditEntry:
    before, after = (None if text is None else from_json(text) for text in (row.before, row.after))
    return AuditEntry(
        row.actor, row.action, row.subject, row.robot, row.reason, before, after, row.time_ns, row.id
    )
