"""The state of a robot, in truth: what is wrong with each part, what an act changes, what is seen of it.

    Condition   what is wrong with one component; a component that is not in a state is well
    State       component -> Condition, as a frozen set, so that states are compared and remembered
    after       state × act -> state and the act's answer: the physics of acts, without their times
    observed    state -> the literals that perfect observers end up with: the settled observation

The simulation (body.py) adds the times, and the search for the cheapest repair (policy.py) goes through the
very same functions: what a repair needs is not written down twice.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from robomend_bench.faults.anatomy import Anatomy, Aspect, Node
from robomend_client.actions import FAILED, NO_PROGRAM, OK
from robomend_client.literals import Atom, Literal, fails


class Mood(StrEnum):
    """How a process behaves."""

    WELL = "well"
    SILENT = "silent"  # it runs and publishes nothing
    WRONG = "wrong"  # it publishes at half its rate
    FAST = "fast"  # it publishes at twice its rate
    STILL = "still"  # it publishes at its rate, and its values do not change any more


class Health(StrEnum):
    """How a device behaves while it has power."""

    WELL = "well"
    HUNG = "hung"  # works again when it has been without power
    DEAD = "dead"


@dataclass(frozen=True, slots=True)
class NodeCondition:
    """What is wrong with a node; the defaults are a healthy one."""

    running: bool = True
    mood: Mood = Mood.WELL  # of the process that runs
    successors: tuple[Mood, ...] = ()  # of the processes that the next starts bring, in order
    ever: Mood = Mood.WELL  # of all processes after those
    starts: bool = True  # False: the program ends at once, with status 127
    stale: bool = False  # it holds a dead connection, to a device or to a node that it is tied to
    short_lived: bool = False  # each process ends some time after its start
    beside: str = ""  # a node: silent as long as that runs
    doubled: bool = False  # somebody who is not in the model publishes its topics, too

    @property
    def speaks(self) -> bool:
        return self.running and self.mood is not Mood.SILENT and not self.stale


@dataclass(frozen=True, slots=True)
class DeviceCondition:
    """What is wrong with a device."""

    on: bool = True  # its relay
    health: Health = Health.WELL
    stuck: bool = False  # its relay does not move any more
    replaced: bool = False  # its drivers use the spare
    complains: bool = False  # its status warns, for no reason


Condition = NodeCondition | DeviceCondition
State = frozenset[tuple[str, Condition]]

HEALTHY: State = frozenset()


@dataclass(frozen=True, slots=True)
class Act:
    """A ground action as it reaches the robot."""

    name: str
    parameters: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.parameters)})"


def node_in(state: State, name: str) -> NodeCondition:
    """Return a node's condition."""
    found = dict(state).get(name)
    return found if isinstance(found, NodeCondition) else NodeCondition()


def device_in(state: State, name: str) -> DeviceCondition:
    """Return a device's condition."""
    found = dict(state).get(name)
    return found if isinstance(found, DeviceCondition) else DeviceCondition()


def put(state: State, name: str, condition: Condition) -> State:
    """Return the state with this condition of a component."""
    rest = {(other, value) for other, value in state if other != name}
    well = condition in (NodeCondition(), DeviceCondition())
    return frozenset(rest) if well else frozenset((*rest, (name, condition)))


# --- what works ----------------------------------------------------------------------------------------


def supplied(anatomy: Anatomy, state: State, device: str) -> bool:
    """Whether a device gets power: its relay, and every feeder on its way."""
    return device_in(state, device).on and all(
        supplied(anatomy, state, feeder) and device_in(state, feeder).health is Health.WELL
        for feeder in anatomy.devices[device].fed_by
    )


def source(anatomy: Anatomy, state: State, device: str) -> str:
    """Return the device that the drivers of `device` use: itself, or its spare."""
    spare = anatomy.devices[device].spare
    return spare if spare is not None and device_in(state, device).replaced else device


def works(anatomy: Anatomy, state: State, device: str) -> bool:
    """Whether what drives a device gets what it needs."""
    used = source(anatomy, state, device)
    return supplied(anatomy, state, used) and device_in(state, used).health is Health.WELL


def silenced(anatomy: Anatomy, state: State) -> frozenset[str]:
    """Return the topics without messages, long after the state began."""
    silent: set[str] = set()
    waiting = [
        topic
        for node in anatomy.nodes.values()
        if not _publishes(anatomy, state, node) and not node_in(state, node.name).doubled
        for topic in node.publishes
    ]
    while waiting:
        topic = waiting.pop()
        if topic not in silent and not anatomy.topics[topic].latched:
            silent.add(topic)
            waiting += anatomy.consumers.get(topic, ())
    return frozenset(silent)


def _publishes(anatomy: Anatomy, state: State, node: Node) -> bool:
    """Whether a node's own process publishes, as far as it is up to itself and its devices."""
    return node_in(state, node.name).speaks and all(works(anatomy, state, device) for device in node.drives)


def abnormal(anatomy: Anatomy, state: State) -> frozenset[Literal]:
    """Return what is observed otherwise than of a healthy robot, each literal negative."""
    if not state:
        return frozenset()
    silent = silenced(anatomy, state)
    wrong = {
        topic
        for name, condition in state
        if isinstance(condition, NodeCondition)
        and (
            condition.mood in (Mood.WRONG, Mood.FAST)
            or (condition.doubled and _publishes(anatomy, state, anatomy.nodes[name]))
        )
        for topic in anatomy.nodes[name].publishes
    }
    still = {
        topic
        for name, condition in state
        if isinstance(condition, NodeCondition) and condition.mood is Mood.STILL
        for topic in anatomy.nodes[name].publishes
    }
    found = [fails("ok", topic) for topic in silent | wrong if anatomy.topics[topic].observed]
    for name, condition in state:
        if isinstance(condition, NodeCondition):
            if not condition.running:
                found.append(fails("running", name))
        elif not condition.on and anatomy.devices[name].switchable:
            found.append(fails("on", name))
    found += (
        Literal(aspect.atom, False)
        for aspect in anatomy.aspects
        if silent.isdisjoint(aspect.flows) and _is_bad(aspect, state, silent, still)
    )
    return frozenset(found)


def _is_bad(aspect: Aspect, state: State, silent: frozenset[str], still: Collection[str]) -> bool:
    standing = [topic in still for topic in aspect.still]
    return (
        (any(standing) and not (len(standing) > 1 and all(standing)))
        or not silent.isdisjoint(aspect.silent)
        or bool(aspect.status and device_in(state, aspect.status).complains)
    )


def unseen(anatomy: Anatomy, state: State) -> frozenset[Atom]:
    """Return what nobody can tell while the state lasts, though it is observed of a healthy robot."""
    if not state or not anatomy.aspects:
        return frozenset()
    silent = silenced(anatomy, state)
    return frozenset(aspect.atom for aspect in anatomy.aspects if not silent.isdisjoint(aspect.flows))


def observed(anatomy: Anatomy, state: State) -> frozenset[Literal]:
    """Return the settled observation: every literal, of either sign."""
    odd, unknown = abnormal(anatomy, state), unseen(anatomy, state)
    well = (each for each in anatomy.healthy if -each not in odd and each.atom not in unknown)
    return frozenset((*well, *odd))


def broken(anatomy: Anatomy, state: State) -> frozenset[str]:
    """Return the components that do not do what they should at this moment."""
    return frozenset(
        name
        for name, condition in state
        if (
            not condition.speaks or condition.mood is not Mood.WELL or condition.doubled
            if isinstance(condition, NodeCondition)
            else not condition.on or (condition.health is not Health.WELL and not condition.replaced)
        )
    )


# --- what acts do --------------------------------------------------------------------------------------


def after(anatomy: Anatomy, state: State, act: Act) -> tuple[State, int]:
    """Return the state that an act leads to, and its answer; OK also where it was so already."""
    match act.name, act.parameters:
        case "start_node", (node,):
            return _started(anatomy, state, node)
        case "stop_node", (node,):
            return ended(state, node), OK
        case "power_up", (device,):
            return _switched(anatomy, state, device, on=True)
        case "shutdown", (device,):
            return _switched(anatomy, state, device, on=False)
        case "switch_to_spare", (device, _):
            state = put(state, device, replace(device_in(state, device), replaced=True))
            return _disconnected(anatomy, state, {device}), OK
        case "reset_bus", (bus,):
            on_bus = {device.name for device in anatomy.devices.values() if device.bus == bus}
            return without_power(anatomy, state, on_bus), OK
        case _:
            raise ValueError(f"no robot knows {act}")


def _started(anatomy: Anatomy, state: State, node: str) -> tuple[State, int]:
    before = node_in(state, node)
    if before.running:
        return state, OK
    if not before.starts:
        return state, NO_PROGRAM
    mood, *later = (*before.successors, before.ever)
    successors = tuple(later[:-1])
    if before.beside and not node_in(state, before.beside).running:
        mood = Mood.WELL
    state = put(state, node, replace(before, running=True, mood=mood, successors=successors, stale=False))
    state = _beside(state, node, Mood.SILENT)
    for other in anatomy.tied[node]:
        state = disconnected(state, other)
    return state, OK


def _switched(anatomy: Anatomy, state: State, device: str, *, on: bool) -> tuple[State, int]:
    before = device_in(state, device)
    if before.on == on:
        return state, OK
    if before.stuck:
        return state, FAILED
    state = put(state, device, replace(before, on=on))
    return (state if on else without_power(anatomy, state, anatomy.fed[device])), OK


def ended(state: State, node: str) -> State:
    """Return the state after a process has ended, by an act or by itself."""
    state = put(state, node, replace(node_in(state, node), running=False, mood=Mood.WELL, stale=False))
    return _beside(state, node, Mood.WELL)


def _beside(state: State, node: str, mood: Mood) -> State:
    """Those who are silent while another node runs."""
    for name, wrong in state:
        if isinstance(wrong, NodeCondition) and wrong.beside == node and wrong.running:
            state = put(state, name, replace(wrong, mood=mood))
    return state


def lost_power(anatomy: Anatomy, state: State, device: str) -> State:
    """Return the state after a device has lost its power, by an act or by itself."""
    state = put(state, device, replace(device_in(state, device), on=False))
    return without_power(anatomy, state, anatomy.fed[device])


def without_power(anatomy: Anatomy, state: State, devices: Iterable[str]) -> State:
    """What was without power for a moment is hung no more, and its drivers hold dead connections."""
    gone = set(devices)
    for device in gone:
        condition = device_in(state, device)
        if condition.health is Health.HUNG:
            state = put(state, device, replace(condition, health=Health.WELL))
    users = {
        device for device in anatomy.devices if source(anatomy, state, device) in gone
    }  # a spare's power is its user's
    return _disconnected(anatomy, state, users)


def _disconnected(anatomy: Anatomy, state: State, devices: Iterable[str]) -> State:
    for device in devices:
        for driver in anatomy.drivers[device]:
            if not anatomy.nodes[driver].reconnects:
                state = disconnected(state, driver)
    return state


def disconnected(state: State, node: str) -> State:
    """Return the state after a node has lost what it is connected to."""
    condition = node_in(state, node)
    return put(state, node, replace(condition, stale=True)) if condition.running else state
