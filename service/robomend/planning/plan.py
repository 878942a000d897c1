"""A repair plan: ground actions in a partial order, with what each is predicted to do.

A step may start when every step in its `after` is done; steps that are not ordered run side by side. The
plan is pure data and goes over HTTP as it is.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

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

_IN_PDDL = re.compile(rf"(?<![\w-])({'|'.join(DOING)})\(([^(),]+)\)")

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
    """Return a sentence with the domain's own actions as people say them: reasons have them as the plan does,
    `start_node(lidar_node) failed`.
    """
    return _IN_PDDL.sub(lambda found: f"{DOING[found[1]]} {found[2]}", text)


def action_titles(acts: Iterable[tuple[str, Sequence[str]]]) -> list[str]:
    """Return actions as people say them, in their order; to stop and to start again is one thing to them."""
    rest = [(name, tuple(parameters)) for name, parameters in acts]
    titles: list[str] = []
    while rest:
        name, parameters = rest.pop(0)
        for (first, second), words in PAIRS.items():
            if name == first and len(parameters) == 1 and (second, parameters) in rest:
                rest.remove((second, parameters))
                titles.append(f"{words} {parameters[0]}")
                break
        else:
            titles.append(action_title(name, parameters))
    return titles


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
