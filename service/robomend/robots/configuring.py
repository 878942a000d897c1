"""What a configuration of a robot must hold to be taken, and how it is kept, with event and audit entry."""

from __future__ import annotations

import asyncio

from robomend.diagnosis.engines import ENGINES
from robomend.errors import InputError, OptionRefused
from robomend.model.system import System
from robomend.observations.language import parse
from robomend.planning.domain.loading import load_domain
from robomend.planning.foresight import check_domain, check_names
from robomend.planning.planners import PLANNERS
from robomend.robots.configuration import RobotConfig, covered, uncovered
from robomend.store import Transaction, records, robots
from robomend.store.records import AuditEntry, Json
from robomend_client.events import Kind
from robomend_client.near import did_you_mean


def put(tx: Transaction, robot: str, config: Json, *, expected: str | None, by: str) -> None:
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
            before=None if before is None else covered(before),
            after=covered(config),
        )
    )


def delete(tx: Transaction, robot: str, *, expected: str, by: str) -> None:
    """Delete a robot; Conflict while a repair is open."""
    before = covered(robots.get(tx, robot).config)
    robots.delete(tx, robot, expected=expected)
    tx.emit(Kind.ROBOT, robot, {"what": "deleted", "by": by})
    tx.note(AuditEntry(actor=by, action="robot.delete", subject=robot, robot=robot, before=before))


async def check(config: RobotConfig, system: System) -> None:
    """Refuse a configuration that speaks of what the model or this installation does not have."""
    for what, parts, name in (
        ("diagnosis.engine", ENGINES, config.engine),
        ("planner", PLANNERS, config.planner),
    ):
        try:
            parts.check(name)
        except OptionRefused as error:
            raise OptionRefused(f"{what}: {error}") from error
    await asyncio.to_thread(actions_of, config, system)
    names_of(config, system)


def actions_of(config: RobotConfig, system: System) -> None:
    """Refuse PDDL that no plan can be made with, and actions that there are not.

    Raises:
        DomainError, InputError: name the place and the remedy.
    """
    domain = load_domain() if config.domain is None else check_domain(config.domain, system.parts)
    check_names("allow", config.allow or (), domain)
    check_names("actions", config.actions, domain)


def names_of(config: RobotConfig, system: System) -> None:
    """Refuse names that the model does not have.

    Raises:
        InputError, ObservationError: name the place and the remedy.
    """
    known = frozenset(system.cnf.components)
    for what, names in (("expected.stopped", config.expected_stopped), ("protected", config.protected)):
        for name in names:
            if name not in known:
                raise InputError(
                    f"{what}: the model {config.model!r} has no component {name!r}{did_you_mean(name, known)}"
                )
    for sentence in config.observed:
        parse(sentence, system.vocabulary)
