"""What a configuration of a robot must hold to be taken, and how it is kept, with event and audit entry."""

from __future__ import annotations

from robomend.diagnosis.engines import ENGINES
from robomend.errors import InputError, OptionRefused
from robomend.model.system import System
from robomend.observations.language import parse
from robomend.planning.planners import PLANNERS
from robomend.robots.configuration import RobotConfig, covered, uncovered
from robomend.robots.readers import Readers
from robomend.store import Transaction, records, robots
from robomend.store.records import AuditEntry, Json
from robomend.turns import Turns
from robomend_client.events import Kind


def put(
    tx: Transaction, robot: str, config: Json, *, expected: str | None, by: str, reason: str = ""
) -> None:
    """Create or replace a robot."""
    created = expected in (None, records.ABSENT)
    before = None if created else robots.get(tx, robot).config
    kept = config if before is None else uncovered(config, before)
    stored = robots.put(tx, robot, kept, expected=expected)
    if before is None:
        uncovered(config, {})  # refuses a covered secret, after it is known that the robot is new
    what = "created" if created else "updated"
    tx.emit(Kind.ROBOT, robot, {"what": what, "etag": stored.etag, "by": by})
    tx.note(
        AuditEntry(
            actor=by,
            action="robot.put",
            subject=robot,
            robot=robot,
            reason=reason,
            before=None if before is None else covered(before),
            after=covered(config),
        )
    )


def delete(tx: Transaction, robot: str, *, expected: str, by: str, reason: str = "") -> None:
    """Delete a robot; Conflict while a repair is open."""
    before = covered(robots.get(tx, robot).config)
    robots.delete(tx, robot, expected=expected)
    tx.emit(Kind.ROBOT, robot, {"what": "deleted", "by": by})
    tx.note(AuditEntry(by, "robot.delete", robot, robot, reason, before=before))


async def check(config: RobotConfig, system: System, readers: Readers) -> None:
    """Refuse a configuration that speaks of what the model or this installation does not have."""
    for what, parts, name in (
        ("diagnosis.engine", ENGINES, config.engine),
        ("planner", PLANNERS, config.planner),
    ):
        try:
            parts.check(name)
        except OptionRefused as error:
            raise OptionRefused(f"{what}: {error}") from error
    if config.domain is not None:
        await readers.actions(config.domain)
    known = frozenset(system.cnf.components)
    for what, names in (("expected.stopped", config.expected_stopped), ("protected", config.protected)):
        for name in names:
            if name not in known:
                raise InputError(f"{what}: the model {config.model!r} has no component {name!r}")
    turns = Turns()
    for sentence in config.observed:
        parse(sentence, system.vocabulary)
        await turns.rest()
