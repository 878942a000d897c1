"""How a robot is: silence is not health.

unhealthy        the diagnosis blames somebody
degraded         it does, and each function works by a variant that does without what is blamed
unknown          nobody observes it: nothing of its `observed` list, or nothing at all, is fresh
partly-unknown   nothing is known to be wrong, and something is not known, or not judged yet, or topics are
                 silent that wait for each other, and were never seen ok
healthy          all that should be observed is, and the diagnosis of that blames nobody

`health_of` alone decides it: for the robot's state, the lists and pages, drills, and the end of a repair.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Coroutine, Mapping
from enum import StrEnum
from functools import partial
from typing import Any

import structlog

from robomend.errors import RobomendError
from robomend.metrics import Metrics
from robomend.planning.configurations import does_without
from robomend.robots.robot import Robot
from robomend.store import Store, Transaction
from robomend.store.records import Json
from robomend_client.events import Kind
from robomend_client.literals import Atom

# --- work that nobody waits for; when it fails, the log says so.

log = structlog.get_logger("robomend.robots.health")


class Background:
    """Tasks of one event loop, which `close` ends."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(self, work: Coroutine[Any, Any, None], name: str) -> None:
        """Do it beside everything else."""
        task = asyncio.create_task(self._logged(work, name), name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Give up what is not done yet."""
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=5.0)

    async def _logged(self, work: Coroutine[Any, Any, None], name: str) -> None:
        try:
            await work
        except RobomendError as error:
            log.warning("not done", what=name, code=error.code, detail=str(error))


class HealthState(StrEnum):
    """See the module."""

    HEALTHY = "healthy"
    UNHEALTHY = "unhealthy"
    DEGRADED = "degraded"
    PARTLY_UNKNOWN = "partly-unknown"
    UNKNOWN = "unknown"

    @property
    def healthy(self) -> bool | None:
        """True and False where that is known; of a robot that is unknown, in part or wholly, nobody knows."""
        known = {HealthState.HEALTHY: True, HealthState.UNHEALTHY: False, HealthState.DEGRADED: False}
        return known.get(self)

    @property
    def faulty(self) -> bool:
        """Whether the diagnosis blames somebody."""
        return self in {HealthState.UNHEALTHY, HealthState.DEGRADED}


UNCLEAR = frozenset({HealthState.UNKNOWN, HealthState.PARTLY_UNKNOWN})


def health_of(robot: Robot) -> tuple[HealthState, tuple[Atom, ...]]:
    """Return how a robot is, and what is not known of it although somebody should report it, or did."""
    sight = robot.sight
    observed = sight.observed
    silent = {atom for atom in observed if not sight.reported(atom)} if observed else set[Atom]()
    unknown = tuple(sorted({*silent, *sight.lapsed(), *sight.not_seen_since_acts()}))
    if robot.current is None:
        return HealthState.UNKNOWN, unknown
    if not robot.current.healthy:
        parts = robot.system.parts
        spared = parts is not None and does_without(parts, robot.function_states(), robot.known().diagnoses)
        return (HealthState.DEGRADED if spared else HealthState.UNHEALTHY), unknown
    if len(silent) == len(observed) and (observed or not robot.literals()):
        return HealthState.UNKNOWN, unknown
    doubtful = unknown or robot.not_judged() or robot.wait_for_themselves()
    return (HealthState.PARTLY_UNKNOWN if doubtful else HealthState.HEALTHY), doubtful


class HealthWatch:
    """Tells by an event when observers of a robot fall silent, and when all of them are heard again."""

    def __init__(self, store: Store, metrics: Metrics, robots: Mapping[str, Robot]) -> None:
        self._store = store
        self._robots = robots
        self._told: dict[str, tuple[bool, tuple[Atom, ...]]] = {}
        self._background = Background()
        metrics.on_demand("robomend_robots", "robots in memory", (), lambda: [((), len(robots))])
        metrics.on_demand(
            "robomend_robots_health", "robots in memory by how they are", ("state",), self._count
        )

    def look(self, state: Robot) -> None:
        """A diagnosis was published or confirmed.

        What lapsed is told when it was silent for another of its lifetimes: of those who report a little
        more rarely than that, there would be no end of news.
        """
        robot = state.id
        if state.gone:
            self._told.pop(robot, None)
            return
        how, unknown = health_of(state)
        again_s = state.sight.may_be_late_s(unknown)
        if again_s > 0:
            state.wake_later("health", again_s, partial(self.look, state))
            return
        before = self._told.get(robot, (False, ()))
        now = (how in UNCLEAR, unknown)
        if now == before:
            return
        self._told[robot] = now
        if len(self._told) > 2 * len(self._robots) + 16:  # of robots that are no longer in memory
            self._told = {name: told for name, told in self._told.items() if name in self._robots}
        if now[0] or before[0]:
            data: dict[str, Any] = {
                "what": "health",
                "state": str(how),
                "unknown": [str(atom) for atom in unknown],
            }
            if not state.revision and not state.obs.entries():  # nothing ever: it was just set up
                data["reported"] = False
            self._background.begin(
                self._store.write(partial(_tell, robot, data)), "event of what is not observed"
            )

    async def close(self) -> None:
        """Write what is to be told."""
        await self._background.close()

    def _count(self) -> list[tuple[tuple[str, ...], float]]:
        counts = Counter(health_of(state)[0] for state in self._robots.values() if not state.stale)
        return [((str(how),), float(counts[how])) for how in HealthState]


def _tell(robot: str, data: Json, tx: Transaction) -> None:
    tx.emit(Kind.ROBOT, robot, data)
