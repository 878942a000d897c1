"""What can be wrong with one component, by name, and what that is in truth.

A fault is a component and a kind. Kinds of nodes are about their processes and about those that the next
starts bring ("successors"); kinds of devices are about power and about the device itself. To add one: a row
here, and the classes of classes.py that draw it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.condition import (
    HEALTHY,
    Health,
    Mood,
    NodeCondition,
    State,
    device_in,
    lost_power,
    put,
    without_power,
)


@dataclass(frozen=True, slots=True, order=True)
class Fault:
    """One kind of fault of one component."""

    component: str
    kind: str

    def __str__(self) -> str:
        return f"{self.component} {self.kind}"


NODE_KINDS: Mapping[str, NodeCondition] = {
    "dead": NodeCondition(running=False),
    "hung": NodeCondition(mood=Mood.SILENT),
    "half-rate": NodeCondition(mood=Mood.WRONG),
    "dead, one mute successor": NodeCondition(running=False, successors=(Mood.SILENT,)),
    "dead, two mute successors": NodeCondition(running=False, successors=(Mood.SILENT, Mood.SILENT)),
    "hung, one mute successor": NodeCondition(mood=Mood.SILENT, successors=(Mood.SILENT,)),
    "dead, one wrong successor": NodeCondition(running=False, successors=(Mood.WRONG,)),
    "hung, one wrong successor": NodeCondition(mood=Mood.SILENT, successors=(Mood.WRONG,)),
    "dead, does not start": NodeCondition(running=False, starts=False),
    "dead, mute for ever": NodeCondition(running=False, ever=Mood.SILENT),
    "hung, mute for ever": NodeCondition(mood=Mood.SILENT, ever=Mood.SILENT),
    "double rate": NodeCondition(mood=Mood.FAST),
    "stands still": NodeCondition(mood=Mood.STILL),
    "second publisher": NodeCondition(doubled=True),
    "ends again and again": NodeCondition(running=False, short_lived=True),
}

BESIDE = "silent beside "
"""Of a node, before another's name: as long as that runs."""

PASSING = frozenset({"brown-out", "dip"})
"""What goes by itself, and leaves drivers with dead connections."""

AGAIN = frozenset({"ends again and again"})
"""What goes by a start, and is there again after some time."""

FOR_EVER = AGAIN | {"second publisher", "complains"}
"""What no act of the robot's repairs for good, whatever it looks like for a while."""


def begin(anatomy: Anatomy, state: State, fault: Fault) -> State:
    """Return the state right after a fault has begun."""
    if fault.kind.startswith(BESIDE):
        wrong = NodeCondition(mood=Mood.SILENT, ever=Mood.SILENT, beside=fault.kind.removeprefix(BESIDE))
        return put(state, fault.component, wrong)
    if fault.component in anatomy.nodes:
        return put(state, fault.component, NODE_KINDS[fault.kind])
    return DEVICE_KINDS[fault.kind](anatomy, state, fault.component)


def lifted(anatomy: Anatomy, state: State, fault: Fault) -> State:
    """Return the state after a fault has gone by itself: a node is not hung any more, power is back."""
    if fault.kind in PASSING:
        return put(
            state, fault.component, replace(device_in(state, fault.component), on=True, health=Health.WELL)
        )
    assert fault.component in anatomy.nodes
    condition = dict(state).get(fault.component)
    if isinstance(condition, NodeCondition) and condition.running:
        return put(state, fault.component, replace(condition, mood=Mood.WELL))
    return state


def settled(anatomy: Anatomy, *faults: Fault) -> State:
    """Return the state of an otherwise healthy robot after these faults, when what passes has passed."""
    state = begun(anatomy, *faults)
    for fault in faults:
        if fault.kind in PASSING:
            state = lifted(anatomy, state, fault)
    return state


def begun(anatomy: Anatomy, *faults: Fault) -> State:
    """Return the state of an otherwise healthy robot with these faults."""
    state = HEALTHY
    for fault in faults:
        state = begin(anatomy, state, fault)
    return state


def _stuck(anatomy: Anatomy, state: State, device: str) -> State:
    state = lost_power(anatomy, state, device)
    return put(state, device, replace(device_in(state, device), stuck=True))


def _dipped(anatomy: Anatomy, state: State, device: str) -> State:
    """Its relay stays where it is: it only gives nothing for a while."""
    state = put(state, device, replace(device_in(state, device), health=Health.DEAD))
    return without_power(anatomy, state, anatomy.fed[device] - {device})


def _complaining(anatomy: Anatomy, state: State, device: str) -> State:
    return put(state, device, replace(device_in(state, device), complains=True))


def _with(health: Health) -> Callable[[Anatomy, State, str], State]:
    def begin_it(anatomy: Anatomy, state: State, device: str) -> State:
        return put(state, device, replace(device_in(state, device), health=health))

    return begin_it


DEVICE_KINDS: Mapping[str, Callable[[Anatomy, State, str], State]] = {
    "off": lost_power,  # its relay opens
    "off for ever": _stuck,  # the same, and does not close any more
    "hung": _with(Health.HUNG),  # it works again when it has been without power
    "broken": _with(Health.DEAD),  # nothing helps
    "brown-out": lost_power,  # its relay opens, and closes again by itself
    "dip": _dipped,  # the same, and its relay tells nothing of it
    "complains": _complaining,  # its status warns for ever, and all that it does is good
}
