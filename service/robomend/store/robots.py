"""Robots: their configuration, and the versions of all that a robot's diagnosis rests on."""

from __future__ import annotations

from sqlalchemy import bindparam, select

from robomend.errors import InputError, NotFound, StateConflict
from robomend.store import folding, schema
from robomend.store.encoding import checked, etag, from_json, to_json
from robomend.store.records import ANY, FIRST_PAGE, Json, Newest, Page, Paging, StoredRobot
from robomend.store.rows import AnyRow, LockedRobot, View
from robomend.store.transaction import Transaction, check_seen

_ROBOTS, _STATES = schema.robots, schema.robot_state

# Made once: it is asked for each robot that is not in memory, and building it costs more than running it.
_NEWEST = (
    select(
        _STATES.c.revision,
        *folding.newest_batches(_STATES.c.robot),
        _ROBOTS.c.etag,
        schema.model_versions.c.version,
    )
    .join_from(_ROBOTS, _STATES, _STATES.c.robot == _ROBOTS.c.id)
    .outerjoin(schema.models, schema.models.c.name == _ROBOTS.c.model)
    .outerjoin(
        schema.model_versions,
        (schema.model_versions.c.name == schema.models.c.name)
        & (schema.model_versions.c.number == schema.models.c.current),
    )
    .where(_ROBOTS.c.id == bindparam("of_robot"))
)

_CLEARED = (
    schema.obs,
    schema.assertions,
    schema.quarantine,
    schema.tried,
    schema.attempts,
    schema.start_ups,
    schema.agent_actions,
    schema.moments,
)
"""What goes with a robot."""


def get(view: View, robot: str) -> StoredRobot:
    """Return a robot's configuration."""
    return _robot(view.one(select(_ROBOTS).where(_ROBOTS.c.id == checked(robot)), f"robot {robot!r}"))


def find(view: View, robot: str) -> StoredRobot | None:
    """Return a robot's configuration, if there is one."""
    row = view.first(select(_ROBOTS).where(_ROBOTS.c.id == checked(robot)))
    return None if row is None else _robot(row)


def page(view: View, paging: Paging = FIRST_PAGE, *, model: str | None = None) -> Page[StoredRobot]:
    """Return the robots by id, all or those that follow one model."""
    query = select(_ROBOTS)
    if model is not None:
        query = query.where(_ROBOTS.c.model == checked(model))
    return view.by_name(query, _robot, paging, "id")


def newest(view: View, robot: str) -> Newest:
    """Return the versions of all that a robot's diagnosis rests on."""
    rows = view.of_log(_NEWEST, {"of_robot": checked(robot)})
    if not rows:
        raise NotFound(f"there is no robot {robot!r}")
    return Newest(folding.newest(rows[0]), rows[0].etag, rows[0].version)


def put(tx: Transaction, robot: str, config: Json, *, expected: str | None) -> StoredRobot:
    """Create or replace a robot. NotFound if its model does not exist.

    `expected`: see `check_seen` (transaction.py).
    """
    state = tx.state(checked(robot))
    row = tx.first(select(_ROBOTS).where(_ROBOTS.c.id == robot).with_for_update())
    tag = etag(config)
    check_seen(f"robot {robot!r}", expected, row.etag if row else None, wanted=tag)
    model = config.get("model")
    if model is not None and not isinstance(model, str):
        raise InputError(f"a robot's model is a name, not {model!r}")
    if row is not None and row.etag == tag:
        return _robot(row)
    made = StoredRobot(robot, config, tag, row.created_ns if row else tx.now_ns, tx.now_ns)
    if made.model is not None:  # kept from being deleted until we are done
        models = schema.models
        wanted = select(models.c.name).where(models.c.name == checked(made.model))
        tx.one(wanted.with_for_update(read=True), f"model {made.model!r}")
    values = {"config": to_json(config), "etag": tag, "model": made.model, "updated_ns": made.updated_ns}
    if row is None:  # an insert, not an upsert: of two instances that create it one must be told
        tx.change(_ROBOTS.insert(), {"id": robot, "created_ns": made.created_ns} | values)
    else:
        tx.change(_ROBOTS.update().where(_ROBOTS.c.id == robot), values)
    if state is None:
        state = LockedRobot(0, 0, None, exists=True)
        new = {"robot": robot, "revision": 0, "folded": 0, "fence": 0, "owner": None}
        tx.change(_STATES.insert(), new)
    tx.now_is(robot, state._replace(exists=True))
    return made


def delete(tx: Transaction, robot: str, *, expected: str | None = ANY) -> None:
    """Delete a robot with its OBS, quarantine, memory, start-up times, moments and queued actions.

    StateConflict while a repair or a drill is open: what a drill has planted must be undone first.
    Its history stays as long as the retention says, and its revision and fencing number go on where they
    were if it is created again.
    """
    state = tx.existing(robot)
    check_seen(f"robot {robot!r}", expected, get(tx, robot).etag)
    repairs = schema.repairs
    still_open = tx.first(select(repairs.c.id).where(repairs.c.robot == robot, repairs.c.open))
    if still_open is not None:
        raise StateConflict(f"repair {still_open.id} of {robot!r} is open; cancel it first")
    drills = schema.drills
    still_open = tx.first(select(drills.c.id).where(drills.c.robot == robot, drills.c.open))
    if still_open is not None:
        raise StateConflict(f"drill {still_open.id} of {robot!r} is open; cancel it first")
    tx.change(_ROBOTS.delete().where(_ROBOTS.c.id == robot))
    for table in _CLEARED:
        tx.change(table.delete().where(table.c.robot == robot))
    at = {"owner": None, "revision": state.revision, "folded": state.revision}  # no batch of before is OBS
    tx.change(_STATES.update().where(_STATES.c.robot == robot), at)
    tx.now_is(robot, state._replace(owner=None, exists=False))


def _robot(row: AnyRow) -> StoredRobot:
    return StoredRobot(row.id, from_json(row.config), row.etag, row.created_ns, row.updated_ns)
