"""The repair loops of the robots that this instance owns: one task for each robot (robot_repairs.py).

orphan or new robot ──► acquire (a fence) ──► RobotRepairs, until the robot is lost or deleted
event in the log    ──► wakes the one that it concerns, whichever instance wrote it
open repair         ──► wakes its robot's, each LOST_S: of one whose event was lost
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence

from robomend.errors import NotFound
from robomend.poller import Seeker
from robomend.repairs.dependencies import Dependencies
from robomend.repairs.robot_repairs import RobotRepairs
from robomend.robots.robot import Robot
from robomend.store import repairs
from robomend.store.records import Fence, Json, Stop
from robomend_client.events import Event, Kind

ORPHANS_S = 1.0
"""How often robots without an owner are looked for: a dead instance's robots are taken over in about this."""

LOST_S = 30.0
"""How often open repairs are looked for of which no event told: of all robots at once, as a thousand looks of
a thousand loops would come together and keep changes waiting."""

CLOSE_S = 3.0
"""For the loops to let go at shutdown."""

WAKING = frozenset({Kind.REPAIR, Kind.CONFIGURATION, Kind.ROBOT, Kind.DIAGNOSIS, Kind.DRILL})
"""Kinds of events that a robot's loop must hear of."""


class RobotLoops:
    """See the module. Belongs to one event loop."""

    def __init__(self, needs: Dependencies) -> None:
        self._needs = needs
        self._store = needs.store
        self._switch = needs.switch
        self._loops: dict[str, RobotRepairs] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._let_go: set[str] = set()  # robots whose loop ended: released before they are kept again
        self._look_for_lost_s = 0.0
        self._seeker = Seeker(self._look, "robots without an owner", ORPHANS_S)
        self._ends: list[Callable[[], None]] = []

    async def start(self) -> None:
        """Begin to follow the events, then to look for robots without an owner."""
        self._ends = [
            self._store.subscribe(self._follow),
            self._store.ownership.on_lost(self._lost),
        ]
        # After following began, so that a stop in between is not missed.
        await self._switch.start()
        self._switch.on_change(self._stop_changed)
        self._needs.robots.diagnosing.on_diagnosis(self._poke)
        self._seeker.start()

    async def close(self) -> None:
        """Let go within a few seconds: running actions are cancelled, journals closed."""
        for end in self._ends:
            end()
        await self._seeker.close(self._tasks.values(), CLOSE_S)

    async def _look(self) -> None:
        await self._acquire()
        if time.monotonic() >= self._look_for_lost_s:
            for robot in await self._store.read(repairs.open_robots):
                if (loop := self._loops.get(robot)) is not None:
                    loop.asked()
            self._look_for_lost_s = time.monotonic() + LOST_S

    async def _acquire(self) -> None:
        """Make a loop for each robot that nobody owns, and for each of ours that has none."""
        await self._switch.look()
        ownership = self._store.ownership
        for robot in tuple(self._let_go):
            await ownership.release(robot)
            self._let_go.discard(robot)
        for robot in {*await ownership.orphans(), *ownership.held} - self._loops.keys():
            with contextlib.suppress(NotFound):  # deleted meanwhile
                fence = await ownership.acquire(robot)
                if fence is not None and robot not in self._loops:
                    self._keep(robot, fence)

    def _keep(self, robot: str, fence: Fence) -> None:
        loop = self._loops[robot] = RobotRepairs(self._needs, robot, fence)
        task = self._tasks[robot] = asyncio.create_task(loop.run(), name=f"running of {robot}")
        task.add_done_callback(lambda _: self._ended(robot, loop))

    def _ended(self, robot: str, loop: RobotRepairs) -> None:
        if self._loops.get(robot) is loop:
            del self._loops[robot], self._tasks[robot]
            # The fence may be an old one, of a robot that another instance has or that was deleted.
            self._let_go.add(robot)
            self._seeker.wake()

    def _lost(self, fence: Fence) -> None:
        loop = self._loops.get(fence.robot)
        if loop is not None and loop.fence == fence:
            self._tasks[fence.robot].cancel()

    def wake(self, robot: str) -> None:
        """What the agents of a robot can do has changed."""
        loop = self._loops.get(robot)
        if loop is not None:
            loop.wake()

    def _poke(self, state: Robot) -> None:
        loop = self._loops.get(state.id)
        if loop is not None:
            loop.poke(state)

    def _follow(self, events: Sequence[Event]) -> None:
        for event in events:
            kind, robot = event.kind, event.robot
            if kind is Kind.STOP:
                self._switch.heard(_stop_of(event.data))
            elif robot is not None and kind in WAKING:
                loop = self._loops.get(robot)
                if kind is Kind.ROBOT and event.data.get("what") == "deleted":
                    task = self._tasks.get(robot)
                    if task is not None:
                        task.cancel()
                elif loop is None:
                    self._seeker.wake()
                elif kind is Kind.REPAIR:
                    loop.asked()
                elif kind is Kind.CONFIGURATION:
                    loop.changes.asked()
                elif kind is Kind.ROBOT and event.data.get("what") in {"updated", "released"}:
                    loop.reconsider()
                else:
                    state = self._needs.robots.memory.states.get(robot)
                    if kind is not Kind.DIAGNOSIS or not _ours(state, event):
                        loop.poke(state)

    def _stop_changed(self) -> None:
        for loop in self._loops.values():
            loop.stopped()


def _ours(state: Robot | None, event: Event) -> bool:
    """Return whether a diagnosis is one of which `_poke` hears, as it is published here."""
    return state is not None and state.has_announced(event.data["revision"])


def _stop_of(data: Json) -> Stop:
    active, reason = bool(data.get("active")), data.get("reason", "")
    return Stop(active, data.get("by"), reason, data.get("since_ns"), data.get("revision", 0))
