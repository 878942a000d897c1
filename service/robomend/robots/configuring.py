"""What a configuration of a robot must hold to be taken, and how it is kept, with event and audit entry."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

from robomend.diagnosis.engines import ENGINES
from robomend.errors import DomainError, InputError, OptionRefused, RobomendError
from robomend.model.components import ComponentModel
from robomend.model.system import System
from robomend.observations.language import parse
from robomend.planning.domain.compilation import Compilation, compile_domain
from robomend.planning.domain.loading import load_domain
from robomend.planning.domain.values import Domain
from robomend.planning.planners import PLANNERS
from robomend.planning.problem import MEND, repair_problem
from robomend.planning.static_facts import Env, StaticFacts
from robomend.robots.configuration import RobotConfig, covered, uncovered
from robomend.robots.readers import Readers
from robomend.store import Transaction, robots
from robomend.store.records import AuditEntry, Json
from robomend.yielding import Turns
from robomend_client.events import Kind
from robomend_client.near import did_you_mean


def put(
    tx: Transaction, robot: str, config: Json, *, expected: str | None, by: str, reason: str = ""
) -> None:
    """Create or replace a robot."""
    known = robots.find(tx, robot)
    before = None if known is None else known.config
    stored = robots.put(tx, robot, uncovered(config, before or {}), expected=expected)
    if known is not None and stored.etag == known.etag:
        return
    what = "created" if before is None else "updated"
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
    await _check_actions(config, system, readers)
    await _check_names(config, system)


async def faults(config: RobotConfig, system: System, readers: Readers) -> list[str]:
    """Return what was in order when the robot was configured, and is no more as its model has changed."""
    found: list[str] = []
    for look in (_check_actions(config, system, readers), _check_names(config, system)):
        try:
            await look
        except RobomendError as error:
            found.append(str(error))
    return found


async def _check_actions(config: RobotConfig, system: System, readers: Readers) -> None:
    wanted = (config.domain, config.allow or (), tuple(config.actions), system.parts)
    if config.domain is None:
        check_actions(*wanted)
    else:
        await readers.call(check_actions, *wanted)


async def _check_names(config: RobotConfig, system: System) -> None:
    turns = Turns()
    for _ in names_checked(config, system):
        await turns.rest()


def check_actions(
    domain: str | None, allow: Iterable[str], actions: Iterable[str], parts: ComponentModel | None
) -> None:
    """Refuse PDDL that no plan can be made with, and actions that there are not. For a worker, or for PDDL
    that is known already.

    Raises:
        DomainError, InputError: name the place and the remedy.
    """
    found = load_domain() if domain is None else check_domain(domain, parts)
    check_names("allow", allow, found, parts)
    check_names("actions", actions, found, parts)


def names_checked(config: RobotConfig, system: System) -> Iterator[None]:
    """Refuse names that the model does not have; yields after each, so that others get their turn.

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
        yield


# --- what can be known of a robot's actions before they are needed: their names, and how many they ground to.
#
# What can never work is refused when the robot is configured, not when a repair needs it.

MOST_WAYS = 1000
"""Ground actions that may achieve one fact: with as many, planning takes about ten seconds on a busy core."""

LOOKED_AT = 5
"""Names that are tried for each place of an effect; components of one kind differ little."""


def check_domain(text: str, model: ComponentModel | None) -> Domain:
    """Return the domain of a robot's own PDDL, if plans can be made with it for this model.

    Raises:
        DomainError: it cannot be read, its init or objects name what the model does not have, or an action
            has so many ground actions that no plan would be found in time.
    """
    domain = load_domain(text, "domain")
    if model is not None:
        facts = StaticFacts(domain, repair_problem(model, domain, (), ()))
        for compilation in compile_domain(domain):
            if any(number > MOST_WAYS for number in _ways(compilation, facts)):
                schema = compilation.schema
                raise DomainError(
                    f"the action {schema.name!r} has {len(schema.parameters)} parameters, which makes more "
                    f"than {MOST_WAYS} ground actions for one effect, too many to plan with; guard the "
                    "parameters with static predicates, such as (spare_for ?s ?h), or leave some out",
                    schema.file,
                    schema.line,
                )
    return domain


def check_names(what: str, names: Iterable[str], domain: Domain, model: ComponentModel | None = None) -> None:
    """Refuse (InputError) names that are no actions of the robot's domain, remedies or acts of its model."""
    own = () if model is None else (*(one.name for one in model.remedies), *model.acts)
    known = dict.fromkeys((*(name for name in domain.schemas if name != MEND), *own))
    for name in names:
        if name not in known:
            raise InputError(
                f"{what}: the robot's domain has no action {name!r}{did_you_mean(name, known)}; "
                f"there are {', '.join(known)}"
            )


def _ways(compilation: Compilation, facts: StaticFacts) -> Iterator[int]:
    """Yield how many ground actions there are for some facts that the action achieves, up to the limit."""
    for effect in compilation.effects:
        variables = compilation.schema.parameters + effect.variables
        kinds = dict(variables)
        terms = [term for term in effect.atom.terms if term in kinds]
        members = sorted(facts.members_of(kinds[terms[0]]))[:LOOKED_AT] if terms else [""]
        for name in members:
            env: Env = {terms[0]: name} if terms else {}
            guards = compilation.guards + effect.guards
            yield sum(1 for _ in islice(facts.bindings(variables, guards, env), MOST_WAYS + 1))
