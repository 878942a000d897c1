"""The plan of a drill, from what a service says: what could be planted, and what stands in the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from robomend.cli.remote.connection import asking
from robomend.cli.tables import diagnoses
from robomend.errors import InputError
from robomend_client.counts import first_few

if TYPE_CHECKING:
    from robomend.model.components import ComponentModel
    from robomend.planning.drill import PlantableFault
    from robomend.robots.configuration import RobotConfig
    from robomend_client.rest import Client

DRILLS = 200
"""So many of the robot's latest drills are looked at for what they have shown."""

MOST_ARROWS = 20
"""Of the arrows that are only believed, so many are printed."""

MOST_NAMES = 6
"""Of the faults that are never planted for one reason."""


class DrillPlan(NamedTuple):
    """What could be planted on a robot."""

    obstacles: list[str]  # that stand in the way now
    faults: list[PlantableFault]
    complete: bool  # they are all
    observers: dict[str, str]  # atom -> who reports it, of its agents
    believed: list[dict[str, Any]]  # arrows of the model that no drill has shown, see `only_believed`


def asked(robot: str, url: str, key: str | None) -> DrillPlan:
    """Ask a service for a robot, and return the plan."""
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
        drills = client.drills(robot, limit=DRILLS)["items"]
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
    complete, found = len(found) <= MOST_FAULTS, found[:MOST_FAULTS]
    return DrillPlan(obstacles, found, complete, who, only_believed(system.parts, found, drills))


def only_believed(
    parts: ComponentModel, faults: Sequence[PlantableFault], drills: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return which topics rest on which by the model alone, each with the faults that would show it: in no
    drill were both seen to fail.
    """
    shown = [set(drill["seen"]["showed"]) for drill in drills if drill["seen"]]
    would = {one.name: set(map(str, one.shows)) for one in faults if one.refused is None}
    publishers = {topic: node.name for node in parts.nodes.values() for topic in node.publishes}
    found = []
    for node in parts.nodes.values():
        for topic, inputs in node.publishes.items():
            for each in publishers.keys() & set(inputs):
                both = {f"not ok({topic})", f"not ok({each})"}
                if not any(both <= one for one in shown):
                    by = [name for name, shows in would.items() if both <= shows]
                    arrow = {"topic": topic, "rests_on": each, "publisher": publishers[each]}
                    found.append({**arrow, "shown_by": by})
    return sorted(found, key=lambda arrow: (arrow["topic"], arrow["rests_on"]))


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


def plan_json(robot: str, plan: DrillPlan) -> dict[str, Any]:
    """Return the plan as `--format json` prints it."""
    return {
        "robot": robot,
        "obstacles": plan.obstacles,
        "faults": [fault_json(fault, plan.observers) for fault in plan.faults],
        "complete": plan.complete,
        "believed": plan.believed,
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


def show_plan(robot: str, plan: DrillPlan) -> None:
    """Print the plan for people."""
    for obstacle in plan.obstacles:
        click.echo(f"refused now: {obstacle}")
    click.echo(f"what could be planted on {robot}; nothing is done")
    for fault in plan.faults:
        if fault.refused is None:
            shows = ", ".join(map(str, fault.shows)) or "nothing"
            click.echo(f"\n  {fault.name}: {fault.act}; undo: {fault.undo}")
            click.echo(f"      shows {shows}\n      {promised(fault)}")
            if fault.remedies:
                click.echo(f"      remedies of the model: {', '.join(fault.remedies)}")
    if not plan.complete:
        click.echo(f"there are more: the first {len(plan.faults)} are shown")
    if plan.believed:
        click.echo("\nonly believed, as no drill here has shown it:")
    for arrow in plan.believed[:MOST_ARROWS]:
        by = " or ".join(arrow["shown_by"][:2]) or f"to stop {arrow['publisher']} by hand"
        click.echo(f"  {arrow['topic']} rests on {arrow['rests_on']}: {by} would show it")
    if (more := len(plan.believed) - MOST_ARROWS) > 0:
        click.echo(f"  and {more} more")
    never: dict[str, list[str]] = {}
    for fault in plan.faults:
        if fault.refused is not None:
            never.setdefault(fault.refused, []).append(fault.name)
    click.echo()
    for why, names in never.items():
        click.echo(f"never: {first_few(names, MOST_NAMES)}: {why}")


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
