"""A repair plan: ground actions in a partial order, with what each is predicted to do.

A step may start when every step in its `after` is done; steps that are not ordered run side by side. The
plan is pure data and goes over HTTP as it is.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from robomend.model.components import ComponentModel
from robomend_client.counts import listed
from robomend_client.literals import Atom, Literal


class Outcome(StrEnum):
    """Three different answers, and none of them is an error."""

    SOLVED = "solved"
    UNSOLVABLE = "unsolvable"  # proved: some goal has no action that reaches it
    GAVE_UP = "gave-up"  # the time ran out: what is not in `unreachable` may have a plan or none


@dataclass(frozen=True, slots=True)
class Step:
    """One ground action of a plan."""

    index: int  # position in the plan, from 0; the serial order is always a valid one
    name: str  # the PDDL action
    parameters: tuple[str, ...]  # the model's own names
    cost: float
    after: tuple[int, ...]  # indices of the steps that must be done before
    preconditions: tuple[Literal, ...]  # over on, off, running, stopped, good, bad and the user's predicates
    effects: tuple[Literal, ...]  # added positive, deleted negative

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.parameters)})"

    def acts_on(self, components: Collection[str]) -> frozenset[str]:
        """Return which of a model's components it is for: those that it names, and those that it makes good
        (`set_mode(low)` names none).
        """
        good = {one.atom.args[0] for one in self.effects if one.positive and one.atom.predicate == "good"}
        return frozenset(good.union(self.parameters).intersection(components))


ACTIONS = {
    "power_up": "Power up",
    "shutdown": "Switch off",
    "start_node": "Start",
    "stop_node": "Stop",
}
"""The domain's own actions, each of one component, as people say them."""

DOING = {
    "power_up": "powering up",
    "shutdown": "switching off",
    "start_node": "starting",
    "stop_node": "stopping",
}
"""The same inside a sentence: "starting lidar_node failed"."""

IS = {
    "ok": ("{} ok", "{} not ok"),
    "on": ("power at {}", "no power at {}"),
    "running": ("{} running", "{} not running"),
}
"""How what is observed is said inside a sentence: "scan not ok", "no power at lidar"."""

_IN_PDDL = re.compile(
    rf"(?<![\w-])(?:(?P<act>{'|'.join(DOING)})|(?P<not>not )?(?P<state>{'|'.join(IS)}))\((?P<of>[^(),]+)\)"
)
_UNMENDED = re.compile(
    r"(?:no known repair: )?([^\s:;]+): (no (?:sequence of )?known actions?) makes it good"
)

PAIRS = {("shutdown", "power_up"): "Power-cycle", ("stop_node", "start_node"): "Restart"}
"""Two actions on one component that people have one word for."""


def action_title(name: str, parameters: Sequence[str]) -> str:
    """Return an action as people say it: `Start hokuyo_node`; of a user's action the words of its name."""
    words = ACTIONS.get(name)
    if words is not None and len(parameters) == 1:
        return f"{words} {parameters[0]}"
    said = " ".join(name.replace("-", "_").split("_")).strip() or name
    said = said[0].upper() + said[1:]
    return f"{said}: {', '.join(parameters)}" if parameters else said


def in_prose(text: str) -> str:
    """Return a sentence with actions and observations as people say them: reasons have them as the plan does,
    `start_node(lidar_node) failed, ok(scan) was not seen`.
    """

    def said(found: re.Match[str]) -> str:
        if found["act"]:
            return f"{DOING[found['act']]} {found['of']}"
        return IS[found["state"]][found["not"] is not None].format(found["of"])

    return _UNMENDED.sub(r"\2 mends \1", _IN_PDDL.sub(said, text))


def step_title(step: Mapping[str, Any]) -> str:
    """Return a step of a plan, as HTTP shows it, as people say it."""
    note = f" ({step['note']})" if step.get("note") else ""
    return f"{action_title(step['name'], step['parameters'])}{note}"


def action_titles(steps: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the steps of a plan as people say them, in their order; to stop and to start again is one thing
    to them.
    """
    rest = list(steps)
    titles: list[str] = []
    while rest:
        step = rest.pop(0)
        title = step_title(step)
        for (first, second), words in PAIRS.items():
            again = [one for one in rest if (one["name"], one["parameters"]) == (second, step["parameters"])]
            if step["name"] == first and len(step["parameters"]) == 1 and again:
                rest.remove(again[0])
                title = f"{words}{title.removeprefix(ACTIONS[first])}"
        titles.append(title)
    return titles


def power_note(model: ComponentModel, cut: str, others: Collection[str], off: Collection[str]) -> str:
    """Return what a person asks before a device is switched off: what goes off with it, or what stays on.

    Args:
        others: what the same plan switches off as well.
        off: what has no power now.
    """
    hardware = [name for name in model.hardware if name not in {cut, *others, *off}]
    along = [name for name in hardware if cut in model.feeders(name)]
    if along:
        names = along if len(along) <= 3 else [*along[:2], f"{len(along) - 2} more"]
        return f"{listed(names)} {'goes' if len(along) == 1 else 'go'} off with it"
    rest = [name for name in hardware if not {*others}.intersection(model.feeders(name))]
    if not rest:
        return ""
    return (
        f"{listed(rest)} {'stays' if len(rest) == 1 else 'stay'} on" if len(rest) < 3 else "all else stays on"
    )


@dataclass(frozen=True, slots=True)
class Plan:
    """The answer of a planner for one diagnosis."""

    outcome: Outcome
    steps: tuple[Step, ...]
    cost: float
    planner: str
    initial: frozenset[Atom]  # the true facts of the completed initial state
    assumed: tuple[Literal, ...]  # facts of the initial state that nobody observed
    unreachable: tuple[str, ...]  # sentences, e.g. "imu: no known action makes it good"
    excluded: tuple[str, ...]  # components left out of the goal (expected stopped, quarantined)
    elapsed_s: float
    pddl: tuple[str, str] | None = None  # domain and problem, on request
