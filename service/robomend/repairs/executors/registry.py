"""The executors by kind: who carries out which action of a robot.

    board     power_up and shutdown by the robot's power board; the default for these
    agent     the robot pulls, on the host of the component; the default for the rest
    process   a program of the service's own settings
    webhook   a signed POST

To add one: 1. a class with `execute` (robomend_client.actions.Executor) and a function that makes it (see
MakeExecutor), in a module of its own here; 2. its lines in this file, above and in EXECUTORS; 3. its row in
docs/repair.md.
One of your own needs no change here: its module, and in your distribution

    [project.entry-points."robomend.executors"]
    mine = "my_package:make"

A program that the service runs itself must be named in the service's own settings: whoever may configure a
robot over HTTP must not thereby choose programs for this computer.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robomend.errors import InputError, OptionRefused
from robomend.planning.policy import POWER_ACTIONS
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.execution_values import Confirm, nobodys
from robomend.robots.boards import WiredBoard
from robomend.store.records import Fence
from robomend_client.actions import Action, ActionResult, Executor, Feedback
from robomend_client.registry import Registry

# --- A repeated action id gets the first result, and acts only once.


KEPT = 1024


class Once:
    """Wraps an executor so that it sees each action id once.

    A second call while the first is under way waits for the same result. An action that was cancelled has
    no result and may be sent again: whether it acted is for OBS to say. The last KEPT results are
    remembered.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._results: OrderedDict[str, asyncio.Future[ActionResult]] = OrderedDict()

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        first = self._results.get(action.id)
        if first is not None and not first.cancelled():
            return await asyncio.shield(first)
        answer: asyncio.Future[ActionResult] = asyncio.get_running_loop().create_future()
        self._results[action.id] = answer
        while len(self._results) > KEPT:
            self._results.popitem(last=False)
        try:
            result = await self._executor.execute(action, feedback)
        except BaseException:  # a cancellation too; it is raised again, and the next one who asks begins anew
            self._results.pop(action.id, None)
            answer.cancel()
            raise
        answer.set_result(result)
        return result


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What an executor of one robot may need."""

    robot: str
    board: WiredBoard | None  # None: the robot has none
    agents: AgentQueue
    hosts: Mapping[str, str | None]  # component -> the host that acts on it; None: any of the robot's
    programs: Mapping[str, Sequence[str]]  # of the service's settings: name -> argument list
    webhook_hosts: Collection[str]  # of the settings too: hosts that may have private addresses
    halt: asyncio.Event  # set when an action is cut off because nobody wants it any more
    confirm: Confirm = nobodys  # awaited right before anything is sent: whoever lost the robot raises Fenced
    fence: Fence | None = None  # of the robot's owner; None: nothing is carried out


class MakeExecutor(Protocol):
    """Makes the executor of one action of one robot."""

    def __call__(self, action: str, options: Mapping[str, Any], around: Surroundings) -> Executor | None:
        """Return it; None: nobody can carry this action out. Makes only: configurations are checked so.

        Args:
            action: the name of the action; its parameters come with each call.
            options: what the robot's configuration says under `actions.ACTION.executor.options`.

        Raises:
            InputError: options that do not fit.
        """
        ...


EXECUTORS = Registry[MakeExecutor](
    "executor",
    "robomend.executors",
    {
        "board": "robomend.repairs.executors.board:make",
        "agent": "robomend.repairs.executors.agent:make",
        "process": "robomend.repairs.executors.process:make",
        "webhook": "robomend.repairs.executors.webhook:make",
    },
    unknown=OptionRefused,
    broken=InputError,
)


def check(configured: Mapping[str, Mapping[str, Any]], around: Surroundings) -> None:
    """Refuse the `actions` of a robot that cannot work, by making their executors.

    Raises:
        OptionRefused: they name an executor which nobody registered.
        InputError: options that do not fit their kind.
    """
    for action in configured:
        try:
            EXECUTORS.check(kind_of(action, configured)[0])
        except OptionRefused as error:
            raise OptionRefused(f"actions.{action}.executor.kind: {error}") from error
    executors(configured, configured, around)


def executors(
    actions: Iterable[str], configured: Mapping[str, Mapping[str, Any]], around: Surroundings
) -> dict[str, Executor]:
    """Return action name -> executor; an action that nobody can carry out is absent.

    Args:
        actions: the action names of the robot's repair domain.
        configured: the robot's `actions`, name -> {"executor": {"kind", "options"} | None, …}.

    Raises:
        OptionRefused: a kind that nobody registered.
        InputError: options that do not fit their kind, or a kind that cannot be loaded.
    """
    found: dict[str, Executor] = {}
    for action in actions:
        kind, options = kind_of(action, configured)
        made = EXECUTORS.load(kind)(action, options, around)
        if made is not None:
            found[action] = Once(made)
    return found


def kind_of(action: str, configured: Mapping[str, Mapping[str, Any]]) -> tuple[str, Mapping[str, Any]]:
    """Return kind and options of an action, those of the configuration or the usual ones."""
    executor = (configured.get(action) or {}).get("executor")
    if executor is not None:
        return executor["kind"], executor.get("options") or {}
    return ("board" if action in POWER_ACTIONS else "agent"), {}
