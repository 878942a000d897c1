"""Whether a fault may be planted on a robot now; the reasons are sentences for people."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator

from robomend.errors import InputError, NotFound, Refused, StateConflict
from robomend.planning.faults import (
    AGENTS_FAULTS,
    NEEDED_ACTION,
    DrilledBoard,
    FaultKind,
    Plantable,
    fault_name,
    plantable,
)
from robomend.planning.policy import Mode
from robomend.robots.configuration import RobotConfig, policy_of, protection_of
from robomend.robots.declared import Declaration, observables_at_hand
from robomend.robots.health import HealthState, health_of
from robomend.robots.robot import Robot


def board_of(config: RobotConfig) -> DrilledBoard | None:
    """Return what a drill may do to a robot's power board."""
    if config.board is None:
        return None
    return DrilledBoard(config.board.protected, config.board.control_port is not None)


def fault_of(state: Robot, kind: FaultKind, component: str | None, topic: str | None) -> Plantable:
    """Return a fault of a robot.

    Raises:
        InputError: its model does not say what could be planted.
        NotFound: the model has no such fault.
    """
    parts = state.system.parts
    if parts is None:
        raise InputError(f"the model of {state.id!r} is no component model: it does not say what to plant")
    config = state.config
    faults = plantable(
        parts, protection_of(config, parts), board_of(config), meant_off=config.expected_stopped
    )
    for fault in faults:
        if (fault.kind, fault.component, fault.topic) == (kind, component, topic):
            return fault
    raise NotFound(f"robot {state.id!r} has no fault {fault_name(kind, component, topic)}")


def check(state: Robot, fault: Plantable) -> None:
    """Refuse a fault that is not to be planted on the robot as it is now.

    Raises:
        Refused: never on this robot as it is configured.
        StateConflict: not now.
    """
    for why in _never(state, fault):
        raise Refused(why)
    for why in _not_now(state, fault):
        raise StateConflict(why)


def obstacles(state: Robot) -> Iterator[str]:
    """Yield why no fault at all is planted on the robot, as it is configured and as it is now."""
    if state.config.policy == "observe":
        yield f"the policy of robot {state.id!r} is 'observe': nothing is ever done to it"
    if not observables_at_hand(state.config, state.system, state.sight.declared.agents()):
        yield "nothing is said to be observed: name it in `observed` of the robot's configuration"
    yield from _no_fault_now(state)


def _never(state: Robot, fault: Plantable) -> Iterator[str]:
    config = state.config
    policy = policy_of(config, state.system.parts)
    if config.policy == "observe":
        yield f"the policy of robot {state.id!r} is 'observe': nothing is ever done to it"
    if fault.refused is not None:
        yield f"{fault.name} is never planted: {fault.refused}"
    undo = NEEDED_ACTION.get(fault.kind)
    if undo is not None and (
        policy.actions.get(undo) is Mode.OBSERVE
        or (policy.allowed is not None and undo not in policy.allowed)
    ):
        yield f"there would be no undo: {undo} is not permitted on this robot"
    if not observables_at_hand(config, state.system, state.sight.declared.agents()):
        yield "nothing is said to be observed: name it in `observed` of the robot's configuration"


def _not_now(state: Robot, fault: Plantable) -> Iterator[str]:
    yield from _no_fault_now(state)
    if (why := nobody_for(fault, state.sight.declared.agents())) is not None:
        yield why


def _no_fault_now(state: Robot) -> Iterator[str]:
    how, unknown = health_of(state)
    if how is not HealthState.HEALTHY:
        missing = f" ({', '.join(map(str, unknown[:5]))} not known)" if unknown else ""
        yield f"the robot is {how}{missing}, so that a fault would not be seen for itself"
    windows = policy_of(state.config, state.system.parts).windows
    if windows and not any(window.holds(time.time_ns()) for window in windows):
        yield "no maintenance window is open"
    if (why := state.interlocked()) is not None:
        yield why


def nobody_for(fault: Plantable, agents: Collection[Declaration]) -> str | None:
    """Return why none of a robot's agents could plant a fault.

    Where none is heard it may ask another instance for work, and one that does not say what it can do may do
    this; if it does not, nothing is planted.
    """
    if fault.kind not in AGENTS_FAULTS or not agents:
        return None
    target = fault.topic or fault.component
    wanted = {"plant_fault", f"plant_fault:{target}"}
    if any(agent.can is None or wanted & agent.can for agent in agents):
        return None
    has = "watches it on a bus of its own" if fault.topic else "supervises it"
    return f"nobody could plant it: no agent of the robot {has}"
