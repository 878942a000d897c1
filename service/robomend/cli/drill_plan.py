"""The plan of a drill, from what a service says: what could be planted, and what stands in the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.remote.connection import asking
from robomend.errors import InputError

if TYPE_CHECKING:
    from robomend.planning.drill import PlantableFault
    from robomend.robots.configuration import RobotConfig
    from robomend_client.rest import Client


def asked(robot: str, url: str, key: str | None) -> tuple[list[str], list[PlantableFault], bool]:
    """Return what stands in the way, the faults, and whether they are all."""
    from robomend.model.loading import load_text
    from robomend.planning.drill import MOST_FAULTS, drill_plan
    from robomend.robots.at_hand import observables_at_hand
    from robomend.robots.configuration import RobotConfig, protection_of

    with asking(url, key, robot=robot) as client:
        state = client.robot(robot).value
        config = RobotConfig.from_json(robot, state["config"])
        model = client.model(config.model).value
        system = load_text(model["source"], name=config.model)
        if system.parts is None:
            raise InputError(f"{config.model} is no component model: it does not say what could be planted")
        observed = observables_at_hand(config, system)
        obstacles = list(_obstacles(client, state, config, bool(observed)))
    faults = drill_plan(
        system.extended(expected_stopped=system.named(config.expected_stopped)),
        system.parts,
        observed,
        protected=protection_of(config, system.parts),
        board=None if config.board is None else config.board.protected,
    )
    found = list(islice(faults, MOST_FAULTS + 1))
    return obstacles, found[:MOST_FAULTS], len(found) <= MOST_FAULTS


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
    robot: str, obstacles: Sequence[str], faults: Sequence[PlantableFault], complete: bool
) -> dict[str, Any]:
    """Return the plan as `--format json` prints it."""
    return {
        "robot": robot,
        "obstacles": list(obstacles),
        "faults": list(map(fault_json, faults)),
        "complete": complete,
    }


def fault_json(fault: PlantableFault) -> dict[str, Any]:
    """Return a fault with its promise."""
    from robomend.planning.drill import BY

    return {
        "kind": str(fault.kind),
        "component": fault.component,
        "by": BY[fault.kind],
        "act": fault.act,
        "undo": fault.undo,
        "refused": fault.refused,
        "shows": list(map(str, fault.shows)),
        "diagnoses": list(map(list, fault.diagnoses)),
        "promise": fault.promise,
    }


def show_plan(robot: str, obstacles: Sequence[str], faults: Sequence[PlantableFault], complete: bool) -> None:
    """Print the plan for people."""
    for obstacle in obstacles:
        click.echo(f"refused now: {obstacle}")
    click.echo(f"what could be planted on {robot}; nothing is done")
    for fault in faults:
        if fault.refused is None:
            shows = ", ".join(map(str, fault.shows)) or "nothing"
            click.echo(f"\n  {fault.act}; undo: {fault.undo}\n      shows {shows}\n      {promised(fault)}")
    click.echo()
    for fault in faults:
        if fault.refused is not None:
            click.echo(f"never: {fault.act}: {fault.refused}")
    if not complete:
        click.echo(f"there are more: the first {len(faults)} are shown")


def promised(fault: PlantableFault) -> str:
    """Return the promise in words."""
    named = " or ".join(" with ".join(bad) for bad in fault.diagnoses)
    words = {
        "unseen": "would not be noticed",
        "told": "told: the only diagnosis",
        "among": f"one of {named}",
        "missed": f"another is blamed: {named}",
    }
    return words[fault.promise]
