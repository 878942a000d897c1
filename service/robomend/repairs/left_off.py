"""What a repair itself switched off or stopped and did not bring back: remembered, brought back, or named.

    shutdown, stop_node ──► left off, on disk with the intent ──► power_up, start_node: not any more
                                │
                                └─ the plan ends half-way: the next one knows that it is off, also where
                                   nobody observes it, and in a later repair; before a person is asked it is
                                   brought back, whatever it rests on; else a reason names it

A user's own action that switches something off means to, and is not counted.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType

from robomend.model.components import ComponentModel
from robomend.planning.plan import Step
from robomend.planning.policy import TAKES_AWAY
from robomend.planning.prediction import OBSERVED_FACTS
from robomend.planning.problem import needs_of
from robomend.robots.robot import Robot
from robomend_client.literals import Atom, Literal, fails, holds

LeftOff = Mapping[str, int]
"""Component -> when we took its power or its process, in nanoseconds."""

NOTHING: LeftOff = MappingProxyType({})


def taken_by(step: Step, state: Robot, expected_stopped: Collection[str]) -> str | None:
    """Return the component that a step is about to switch off or stop, if it is not off by what is known."""
    if step.name not in TAKES_AWAY or len(step.parameters) != 1:
        return None
    [name] = step.parameters
    return None if name in expected_stopped or state.sight.value(_works(state, name)) is False else name


def given_by(step: Step) -> frozenset[str]:
    """Return the components that a step switches on or starts."""
    return frozenset(
        effect.atom.args[0]
        for effect in step.effects
        if effect.positive and effect.atom.predicate in OBSERVED_FACTS
    )


def still(state: Robot, left: LeftOff) -> dict[str, int]:
    """Return what OBS does not show on or running; OBS has had time to tell."""
    return {name: when for name, when in left.items() if state.sight.value(_works(state, name)) is not True}


def unknown(state: Robot, left: LeftOff) -> tuple[Literal, ...]:
    """Return, as what a plan may start from, what is off by our doing and observed by nobody."""
    atoms = [_works(state, name) for name in left]
    return tuple(Literal(atom, False) for atom in atoms if state.sight.value(atom) is None)


def returning(parts: ComponentModel, left: LeftOff) -> tuple[Step, ...]:
    """Return the acts that bring back what is left off: power first, supplies before what they feed, then the
    nodes, each after those that it needs. Nothing is expected of them but that they are on, or run.
    """
    devices = [name for name in parts.hardware if name in left and parts.switchable(name)]
    devices.sort(key=lambda name: len(parts.feeders(name)))
    nodes = [name for name in parts.nodes if name in left and parts.nodes[name].restartable]
    needs = needs_of(parts)
    ordered: list[str] = []
    while nodes:  # without circles: needs_of leaves them out
        ready = [name for name in nodes if not any((name, other) in needs for other in nodes)]
        ordered += ready
        nodes = [name for name in nodes if name not in ready]
    acts = [("power_up", "off", "on", name) for name in devices]
    acts += [("start_node", "stopped", "running", name) for name in ordered]
    return tuple(
        Step(i, act, (name,), 1.0, (), (holds(lost, name),), (holds(kept, name), fails(lost, name)))
        for i, (act, lost, kept, name) in enumerate(acts)
    )


def in_words(state: Robot, left: LeftOff) -> str:
    """Return what is left, for the reason of a repair's end; what OBS says from before is no news."""
    found: dict[str, list[str]] = {"off": [], "stopped": []}
    for name, when in sorted(left.items()):
        atom = _works(state, name)
        entry = state.obs.get(atom)
        if state.sight.value(atom) is not True or entry is None or entry.time_ns <= when:
            found["off" if atom.predicate == "on" else "stopped"].append(name)
    return "".join(f"; left {how}: {', '.join(names)}" for how, names in found.items() if names)


def _works(state: Robot, name: str) -> Atom:
    parts = state.system.parts
    return Atom("on" if parts is not None and name in parts.hardware else "running", (name,))
