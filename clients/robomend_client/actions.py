"""The one signature of everything that can act: a name, a list of strings, an integer result, feedback.

It is the paper's repair action (section IV, b), so that a ROS action server, a power board, a process or a
webhook are the same to the plan. To add an executor, write a class with this `execute` in
robomend/repairs/executors/, or on the robot a handler in robomend_client/agent/.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

OK = 0
"""The result of an action that did what its name says. Every other integer is a failure."""

FAILED = 1
REFUSED = 2  # by policy, allow-list or protection, or by who should act (a faulty channel): it did not act
TIMED_OUT = 3  # no answer in time: whether it acted is unknown
UNREACHABLE = 4  # nobody there to act: it did not act
CANCELLED = 5
UNDONE_BEFORE = 6  # of a drill's undo: nothing of it is there (any more)
NOT_EXECUTABLE = 126  # as a shell says: the program may not be executed
NO_PROGRAM = 127  # … there is no such program


BY_COMPONENT = frozenset({"plant_fault", "undo_fault"})
"""Actions that go to the agent which has the component, their first parameter, whatever the others are."""

LEASES_S = (30, 60, 120, 300, 600, 1800, 3600)
"""For how long a drill's fault may be planted at most, in seconds: the third parameter of `plant_fault`."""


def offered(can: Collection[str] | None, name: str, parameters: Sequence[str]) -> bool:
    """Return whether who says this of itself is handed an action.

    `can`: `name`, or `name:parameter,parameter`; of a drill's actions the first one only. None: anything.
    """
    return can is None or name in can or f"{name}:{on(name, parameters)}" in can


def on(name: str, parameters: Sequence[str]) -> str:
    """Return what stands behind the colon of an offer: on what an action is done."""
    return parameters[0] if name in BY_COMPONENT else ",".join(parameters)


def not_started(error: BaseException | None) -> int:
    """Return the result for a program that could not be started."""
    if isinstance(error, FileNotFoundError):
        return NO_PROGRAM
    return NOT_EXECUTABLE if isinstance(error, PermissionError) else UNREACHABLE


@dataclass(frozen=True, slots=True)
class Action:
    """One ground action, e.g. Action("repair-7:2", "power_up", ("jaguar",), 10.0)."""

    id: str  # `repair:step`; a repeated id gets the first result and acts only once
    name: str
    parameters: tuple[str, ...]
    timeout_s: float

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.parameters)})"


@dataclass(frozen=True, slots=True)
class ActionResult:
    """The integer the paper's signature asks for, and a sentence for people."""

    code: int
    message: str = ""

    @property
    def ok(self) -> bool:
        return self.code == OK


@dataclass(frozen=True, slots=True)
class Settle:
    """The service asks the observers of these atoms to drop their samples, judge anew, and say so with
    `n`.
    """

    n: int
    atoms: tuple[str, ...]  # sentences, e.g. "ok(scan)"


@dataclass(frozen=True, slots=True)
class Orders:
    """What the service answers an agent that asks for something to do."""

    action: Action | None = None
    settle: Settle | None = None


Feedback = Callable[[int, str], None]
"""Called on the way with (feedback integer, sentence); may be called from the event loop only."""


class Executor(Protocol):
    """Carries out actions of some names. Implementations bound every wait by `action.timeout_s`.

    `execute` never raises for what the world does (that is a result); it is cancelled by cancelling the task,
    and must then leave nothing running within one second.
    """

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult: ...
