"""A repair plan: ground actions in a partial order, with what each is predicted to do.

A step may start when every step in its `after` is done; steps that are not ordered run side by side. The
plan is pure data and goes over HTTP as it is.
"""

from __future__ import annotations

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
