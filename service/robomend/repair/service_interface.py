"""What the HTTP interface asks of the repair loop: one protocol, plain values in and out.

`create_app` is given an object with these methods; the routers translate HTTP to calls of it and delegate.
Every mapping that comes back holds JSON values only and is served as it is, in the literature's words:

    repair      {"id", "robot", "state", "policy", "round", "diagnosis": {"bad", "good"} | null,
                 "plan": [step…], "cost", "assumed": [literal…], "waiting_for": [literal…], "reason", "by",
                 "created_ns", "updated_ns", "finished_ns" | null}
    step        {"index", "name", "parameters", "after", "cost", "state", "result" | null, "message"}
    action      {"id", "name", "parameters", "timeout_s", "host" | null}

`state` of a repair is one of REPAIR_STATES. "escalated", "failed" and "cancelled" are three different ends.

Errors are those of robomend.errors: NotFound (no such robot, repair or action), Conflict (not in the state
that the request needs), Refused (policy, protection, stop), and the backends' own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

Json = Mapping[str, Any]

REPAIR_STATES = (
    "waiting",  # for every literal of the robot's `observed` list, for the diagnosis to hold, or for a slot
    "planning",
    "awaiting-approval",
    "running",
    "verifying",  # every step is done; the next diagnosis decides
    "repaired",
    "escalated",  # a person is needed; the reason says why, and what was tried
    "failed",  # a part of the service failed: engine, planner, configuration
    "cancelled",  # by a person, by the global stop, or because the diagnosis changed under a plan that waited
)

OPEN_STATES = REPAIR_STATES[:5]
"""A repair in one of these may still act."""


class Repairs(Protocol):
    """The repair loop of every robot that this instance owns, as the routers see it."""

    async def start(self) -> None:
        """Take up the work: re-enter unfinished repairs from the journal. Called once, before serving."""
        ...

    async def close(self) -> None:
        """Let go within a few seconds: running actions are cancelled, journals closed, workers ended."""
        ...

    def end_waits(self) -> None:
        """Let every waiting agent go with nothing to do: the service shuts down."""
        ...

    async def plan(
        self, robot: str, *, bad: Sequence[str] | None, planner: str | None, timeout_s: float, pddl: bool
    ) -> Json:
        """Plan without acting: for the diagnosis `bad`, or for the best choice now when it is None.

        Returns {"choice": {"bad", "good", "probability"}, "plan": a Plan as JSON, "alternatives": […],
        "probe": … | null}.
        """
        ...

    async def create(self, robot: str, *, bad: Sequence[str] | None, by: str, reason: str) -> Json:
        """Begin a repair on request. Conflict if one is open.

        Under the policy `approve` the asker's word is no approval: it must still be approved.
        """
        ...

    async def repairs(self, robot: str, *, before: str | None, limit: int) -> Sequence[Json]:
        """Return up to `limit` repairs of the robot, newest first, older than the repair `before`."""
        ...

    async def repair(self, repair_id: str) -> Json:
        """Return one repair with its steps."""
        ...

    async def approve(self, repair_id: str, *, by: str, reason: str) -> Json:
        """Let a repair that awaits approval run. Conflict in any other state."""
        ...

    async def cancel(self, repair_id: str, *, by: str, reason: str) -> Json:
        """End an open repair; running actions are cancelled. Conflict if it has ended already."""
        ...

    async def next_action(self, robot: str, *, host: str | None, wait_s: float) -> Json | None:
        """Hand the agent on `host` its next action, waiting up to `wait_s`; None: nothing to do.

        An action is handed out again until its first feedback or result comes in, so that an answer lost on
        the way loses no action; the agent knows an id that it has had.
        """
        ...

    async def action_robot(self, action_id: str) -> str:
        """Return the robot that an action belongs to, so that a robot's key opens its own actions only."""
        ...

    async def feedback(self, action_id: str, *, code: int, message: str, by: str) -> None:
        """Note how far an action is; after its result this is a Conflict."""
        ...

    async def result(self, action_id: str, *, code: int, message: str, by: str) -> Json:
        """Take an action's result; a repeated one is answered with the first: {"code", "message"}."""
        ...

    async def stopped(self) -> Json:
        """Return {"active": bool, "by": str | null, "reason": str, "since_ns": int | null}."""
        ...

    async def stop(self, *, by: str, reason: str) -> Json:
        """The global stop: no action starts anywhere and running ones are cancelled. Survives a restart."""
        ...

    async def resume(self, *, by: str, reason: str) -> Json:
        """Lift the global stop."""
        ...

    async def quarantined(self, robot: str) -> Mapping[str, str]:
        """Return component -> why it is not tried again."""
        ...

    async def release(self, robot: str, component: str, *, by: str, reason: str) -> None:
        """Let a quarantined component be tried again. NotFound if it is not in quarantine."""
        ...
