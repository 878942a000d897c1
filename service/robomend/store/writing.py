"""Transaction: models, robots, observations, keys, the stop. RepairWriting has the repair loop's half."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from sqlalchemy import select

from robomend.entry import Entry
from robomend.errors import InputError, NotFound, PreconditionFailed, PreconditionRequired, StateConflict
from robomend.store import schema
from robomend.store.encoding import (
    atom_to_text,
    batch_to_text,
    checked,
    checked_ns,
    checked_or_none,
    etag,
    new_id,
    to_json,
)
from robomend.store.reading import key_of
from robomend.store.records import (
    ABSENT,
    ANY,
    ApiKey,
    Json,
    SignIn,
    Stop,
    StoredAssertion,
    StoredModel,
    StoredRobot,
)
from robomend.store.repair_writing import RepairWriting
from robomend.store.transaction import LockedRobot
from robomend_client.literals import Atom


class SqlTransaction(RepairWriting):
    """robomend.store.interface.Transaction."""

    # --- models

    def put_model(self, name: str, source: str, *, format: str, by: str, expected: str | None) -> StoredModel:
        current = self._current_model(name)
        _check_expected(f"model {name!r}", expected, current.version if current else None)
        digest = hashlib.sha256(f"{checked(format)}\n{checked(source)}".encode()).hexdigest()[:20]
        if current is not None and current.version == digest:
            return current
        number = current.number + 1 if current else 1
        model = StoredModel(name, digest, number, format, source, self.now_ns, checked(by))
        row = {"name": name, "number": number, "version": digest, "format": format, "source": source}
        self.change(schema.model_versions.insert(), row | {"created_ns": self.now_ns, "by": by})
        self.replace(schema.models, {"name": name, "current": number})
        return model

    def delete_model(self, name: str, *, expected: str | None = ANY) -> None:
        current = self._current_model(name)
        if current is None:
            raise NotFound(f"there is no model {name!r}")
        _check_expected(f"model {name!r}", expected, current.version)
        followers = self.rows(select(schema.robots.c.id).where(schema.robots.c.model == name).limit(1))
        if followers:
            raise StateConflict(
                f"robot {followers[0].id!r} follows the model {name!r}; give it another one first"
            )
        self.change(schema.models.delete().where(schema.models.c.name == name))
        self.change(schema.model_versions.delete().where(schema.model_versions.c.name == name))

    def _current_model(self, name: str) -> StoredModel | None:
        table = schema.models
        if self._first(select(table).where(table.c.name == checked(name)).with_for_update()) is None:
            return None
        return self.model(name)

    # --- robots

    def put_robot(self, robot: str, config: Json, *, expected: str | None) -> StoredRobot:
        table, state = schema.robots, self.state(checked(robot))
        row = self._first(select(table).where(table.c.id == robot).with_for_update())
        _check_expected(f"robot {robot!r}", expected, row.etag if row else None)
        model = config.get("model")
        if model is not None and not isinstance(model, str):
            raise InputError(f"a robot's model is a name, not {model!r}")
        tag = etag(config)
        if row is not None and row.etag == tag:
            return self.robot(robot)
        made = StoredRobot(robot, config, tag, row.created_ns if row else self.now_ns, self.now_ns)
        if made.model is not None:  # kept from being deleted until we are done
            models = schema.models
            wanted = select(models.c.name).where(models.c.name == checked(made.model))
            self._one(wanted.with_for_update(read=True), f"model {made.model!r}")
        values = {"config": to_json(config), "etag": tag, "model": made.model, "updated_ns": made.updated_ns}
        if row is None:  # an insert, not an upsert: of two instances that create it one must be told
            self.change(table.insert(), {"id": robot, "created_ns": made.created_ns} | values)
        else:
            self.change(table.update().where(table.c.id == robot), values)
        if state is None:
            state = LockedRobot(0, 0, None, exists=True)
            row_of_state = {"robot": robot, "revision": 0, "fence": 0, "owner": None}
            self.change(schema.robot_state.insert(), row_of_state)
        self._own.states[robot] = state._replace(exists=True)
        return made

    def delete_robot(self, robot: str, *, expected: str | None = ANY) -> None:
        state = self.existing(robot)
        _check_expected(f"robot {robot!r}", expected, self.robot(robot).etag)
        repairs = schema.repairs
        still_open = self.rows(select(repairs.c.id).where(repairs.c.robot == robot, repairs.c.open).limit(1))
        if still_open:
            raise StateConflict(f"repair {still_open[0].id} of {robot!r} is open; cancel it first")
        self.change(schema.robots.delete().where(schema.robots.c.id == robot))
        for table in (
            schema.obs,
            schema.assertions,
            schema.quarantine,
            schema.tried,
            schema.attempts,
            schema.agent_actions,
        ):
            self.change(table.delete().where(table.c.robot == robot))
        states = schema.robot_state
        self.change(states.update().where(states.c.robot == robot).values(owner=None))
        self._own.states[robot] = state._replace(owner=None, exists=False)

    # --- observations and diagnoses

    def observe(
        self,
        robot: str,
        *,
        accepted: Sequence[Entry] = (),
        changed: Sequence[Entry] = (),
        forgotten: Sequence[Atom] = (),
        asserted: Sequence[StoredAssertion] = (),
        withdrawn: Sequence[str] = (),
        expected: int | None = None,
    ) -> int:
        state = self.existing(robot)
        if expected is not None and expected != state.revision:
            error = StateConflict(
                f"{robot!r} is at revision {state.revision}, not {expected}; load OBS again"
            )
            error.code = "stale-revision"
            raise error
        own, revision = self._own, state.revision + 1
        own.history.append(
            {
                "robot": robot,
                "revision": revision,
                "time_ns": self.now_ns,
                "data": batch_to_text(accepted, asserted, withdrawn),
            }
        )
        for entry in changed:
            atom = atom_to_text(entry.atom)
            own.obs[robot, atom] = {
                "robot": robot,
                "atom": atom,
                "positive": entry.positive,
                "source": checked(entry.source),
                "time_ns": checked_ns(entry.time_ns),
                "expires_ns": None if entry.expires_ns is None else checked_ns(entry.expires_ns),
            }
        for gone in forgotten:
            own.obs[robot, atom_to_text(gone)] = None
        own.states[robot] = state._replace(revision=revision)
        own.revised.add(robot)
        if asserted or withdrawn:
            self._assert(robot, asserted, withdrawn)
        return revision

    def _assert(self, robot: str, asserted: Sequence[StoredAssertion], withdrawn: Sequence[str]) -> None:
        table = schema.assertions
        for name in withdrawn:
            gone = table.delete().where(table.c.robot == robot, table.c.name == checked(name))
            if not self.change(gone):
                raise NotFound(f"{robot!r} has no assertion {name!r}")
        for assertion in asserted:
            self.replace(
                table,
                {
                    "robot": robot,
                    "name": checked(assertion.name),
                    "sentence": checked(assertion.sentence),
                    "source": checked(assertion.source),
                    "time_ns": checked_ns(assertion.time_ns),
                    "expires_ns": None if assertion.expires_ns is None else checked_ns(assertion.expires_ns),
                },
            )

    def record_diagnosis(self, robot: str, revision: int, result: Json, *, model_version: str = "") -> None:
        self.existing(robot)
        self._own.diagnoses.append(
            {
                "robot": robot,
                "revision": checked_ns(revision),
                "model_version": checked(model_version),
                "time_ns": self.now_ns,
                "result": to_json(result),
            }
        )

    # --- keys and the stop

    def add_key(self, *, name: str, hash: str, role: str, robot: str | None, by: str) -> ApiKey:
        table = schema.api_keys
        if self.rows(select(table.c.id).where(table.c.name == checked(name), table.c.revoked_ns.is_(None))):
            raise StateConflict(f"there is a key named {name!r}; revoke it first, or take another name")
        key = ApiKey(new_id("k-"), name, checked(hash), role, robot, self.now_ns, checked(by))
        self._insert(
            table,
            {
                "id": key.id,
                "name": name,
                "hash": hash,
                "role": checked(role),
                "robot": checked_or_none(robot),
                "created_ns": self.now_ns,
                "by": by,
                "revoked_ns": None,
            },
        )
        return key

    def revoke_key(self, key: str) -> ApiKey:
        table = schema.api_keys
        self.change(
            table.update().where(table.c.id == checked(key), table.c.revoked_ns.is_(None)),
            {"revoked_ns": self.now_ns},
        )
        return key_of(self._one(select(table).where(table.c.id == key), f"key {key!r}"))

    def add_sign_in(self, hash: str, key: str, *, expires_ns: int, most: int) -> SignIn:
        table, keys = schema.sign_ins, schema.api_keys
        valid = select(keys).where(keys.c.id == checked(key), keys.c.revoked_ns.is_(None))
        made = SignIn(checked(hash), key_of(self._one(valid, f"key {key!r}")), self.now_ns, expires_ns)
        self.change(table.delete().where(table.c.expires_ns <= self.now_ns))
        of_key = select(table.c.hash).where(table.c.key == key).order_by(table.c.created_ns.desc())
        beyond = [row.hash for row in self.rows(of_key.offset(most - 1))]
        if beyond:
            self.change(table.delete().where(table.c.hash.in_(beyond)))
        row = {"hash": hash, "key": key, "created_ns": self.now_ns, "expires_ns": checked_ns(expires_ns)}
        self.change(table.insert(), row)
        return made

    def end_sign_in(self, hash: str) -> None:
        table = schema.sign_ins
        self.change(table.delete().where(table.c.hash == checked(hash)))

    def set_stop(self, active: bool, *, by: str, reason: str) -> Stop:
        self.hold_stop("pg_advisory_xact_lock")
        stop = Stop(active, by, reason, self.now_ns)
        value = {"active": active, "by": by, "reason": reason, "since_ns": self.now_ns}
        self.replace(schema.settings, {"name": "stop", "value": to_json(value)})
        return stop


def _check_expected(what: str, expected: str | None, current: str | None) -> None:
    """Compare the version that the caller has seen with the current one."""
    if current is None:
        if expected not in (None, ABSENT):
            raise PreconditionFailed(f"{what} does not exist; leave If-Match out to create it")
    elif expected is None:
        raise PreconditionRequired(f"{what} exists; send its ETag as If-Match to replace it")
    elif expected == ABSENT:
        raise PreconditionFailed(f"{what} exists already")
    elif expected not in (ANY, current):
        raise PreconditionFailed(f"{what} is at version {current}, not {expected}; read it again")
