"""The plan of a drill, from what a service says: what could be planted, and what stands in the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.remote.connection import asking
from robomend.cli.tables import diagnoses
from robomend.errors import InputError

if TYPE_CHECKING:
    from robomend.planning.drill import PlantableFault
    from robomend.robots.configuration import RobotConfig
    from robomend_client.rest import Client


def asked(
    robot: str, url: str, key: str | None
) -> tuple[list[str], list[PlantableFault], bool, dict[str, str]]:
    """Return what stands in the way, the faults, whether they are all, and who observes what."""
    from robomend.drills.permission import board_of, nobody_for
    from robomend.model.loading import load_text
    from robomend.planning.drill import MOST_FAULTS, drill_plan
    from robomend.robots.configuration import RobotConfig, protection_of
    from robomend.robots.declared import declaration, observables_at_hand

    with asking(url, key, robot=robot) as client:
        state = client.robot(robot).value
        config = RobotConfig.from_json(robot, state["config"])
        model = client.model(config.model).value
        system = load_text(model["source"], name=config.model)
        if system.parts is None:
            raise InputError(f"{config.model} is no component model: it does not say what could be planted")
        agents = [
            declaration(
                said["agent"],
                said["host"],
                said["can"],
                dict.fromkeys(said["observes"], (0.0, 0.0)),
                system.vocabulary,
            )
            for said in state.get("agents", ())
        ]
        observed = observables_at_hand(config, system, agents)
        obstacles = list(_obstacles(client, state, config, bool(observed)))
    faults = drill_plan(
        system.extended(expected_stopped=system.named(config.expected_stopped)),
        system.parts,
        observed,
        protected=protection_of(config, system.parts),
        board=board_of(config),
        meant_off=config.expected_stopped,
    )
    found = [
        one if one.refused or (why := nobody_for(one, agents)) is None else replace(one, refused=why)
        for one in islice(faults, MOST_FAULTS + 1)
    ]
    who = {str(atom): f"agent {agent.agent}" for agent in agents for atom in agent.observes}
    return obstacles, found[:MOST_FAULTS], len(found) <= MOST_FAULTS, who


def _obstacles(
    client: Client, state: Mapping[str, Any], config: RobotConfig, observed: bool
) -> Iterator[str]:
    """Yield why a drill would be refused now."""
    import time

    from robomend.planning.policy import Window
    from robomend.repairs.states import ENDS

    if config.policy == "observe":
        yield "the robot's policy is `observe`: nothing is ever done to it"
    if not observed:
        yield "nothing is said to be observed: name it in `observed` of the robot's configuration"
    if state["state"] != "healthy":
        yield f"the robot is {state['state']}, so that a fault would not be seen for itself"
    stop = client.stopped()
    if stop["active"]:
        yield f"the global stop is active, set by {stop['by']}: {stop['reason']}"
    windows = list(map(Window.of, config.windows))
    if windows and not any(window.holds(time.time_ns()) for window in windows):
        yield "no maintenance window is open"
    ends = {str(end) for end in ENDS}
    for repair in client.repairs(config.id, limit=10)["items"]:
        if repair["state"] not in ends:
            yield f"the repair {repair['id']} is {repair['state']}"


def plan_json(
    robot: str,
    obstacles: Sequence[str],
    faults: Sequence[PlantableFault],
    complete: bool,
    observers: Mapping[str, str],
) -> dict[str, Any]:
    """Return the plan as `--format json` prints it."""
    return {
        "robot": robot,
        "obstacles": list(obstacles),
        "faults": [fault_json(fault, observers) for fault in faults],
        "complete": complete,
    }


def fault_json(fault: PlantableFault, observers: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return a fault with its promise; `observers`: who reports what, of its agents."""
    from robomend.planning.faults import BY

    return {
        "kind": str(fault.kind),
        "component": fault.component,
        "topic": fault.topic,
        "by": BY[fault.kind],
        "act": fault.act,
        "undo": fault.undo,
        "refused": fault.refused,
        "shows": list(map(str, fault.shows)),
        "observers": {
            atom: observers[atom]
            for atom in (str(one.atom) for one in fault.shows)
            if observers and atom in observers
        },
        "diagnoses": list(map(list, fault.diagnoses)),
        "promise": fault.promise,
        "remedies": list(fault.remedies),
    }


def show_plan(robot: str, obstacles: Sequence[str], faults: Sequence[PlantableFault], complete: bool) -> None:
    """Print the plan for people."""
    for obstacle in obstacles:
        click.echo(f"refused now: {obstacle}")
    click.echo(f"what could be planted on {robot}; nothing is done")
    for fault in faults:
        if fault.refused is None:
            shows = ", ".join(map(str, fault.shows)) or "nothing"
            click.echo(f"\n  {fault.name}: {fault.act}; undo: {fault.undo}")
            click.echo(f"      shows {shows}\n      {promised(fault)}")
            if fault.remedies:
                click.echo(f"      remedies of the model: {', '.join(fault.remedies)}")
    click.echo()
    for fault in faults:
        if fault.refused is not None:
            click.echo(f"never: {fault.name}: {fault.act}: {fault.refused}")
    if not complete:
        click.echo(f"there are more: the first {len(faults)} are shown")


def promised(fault: PlantableFault) -> str:
    """Return the promise in words."""
    named = diagnoses(fault.diagnoses)
    nobody = "blames nobody: it is of the board, which the model does not know"
    words = {
        "unseen": "would not be noticed" if fault.component else nobody,
        "told": "told: the only diagnosis",
        "among": f"one of {named}",
        "missed": f"another is blamed: {named}",
    }
    return words[fault.promise]
