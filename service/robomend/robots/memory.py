"""The robots in memory, a cache of the store: read when they are first asked for, again when they are old.

A robot to which nothing happens makes room for others; a wait, a timer, a repair or a write under way keeps
it. All belongs to one event loop.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from weakref import WeakValueDictionary

from robomend.errors import NotFound
from robomend.robots.batches import Words, stored_assertion
from robomend.robots.configuration import RobotConfig
from robomend.robots.robot import Robot
from robomend.robots.systems import Systems
from robomend.store import Store, View, diagnoses, models, observations, records, robots, start_ups

WRITE_S = 10.0
"""Longest that a reader waits for a write under way before it reads the store anew."""


class Memory:
    """See the module."""

    def __init__(
        self,
        store: Store,
        models: Systems,
        most: int,
        *,
        taken_up: Callable[[Robot], Awaitable[None]],
        left: Callable[[str], Awaitable[None]],
    ) -> None:
        """`most` idle robots are kept; `taken_up` hears of each that was read, `left` of one that is gone."""
        self._store = store
        self._models = models
        self._most = most
        self._taken_up = taken_up
        self._left = left
        # Whoever works with a state holds it, and it is found here as long as anybody does: there are never
        # two of one robot. Nothing else keeps a state but its place among those used last.
        self.states: WeakValueDictionary[str, Robot] = WeakValueDictionary()
        self._used: OrderedDict[str, Robot] = OrderedDict()
        self._loading: dict[str, asyncio.Lock] = {}

    def at_hand(self, robot: str) -> Robot | None:
        """Return a robot's state if it was used lately and is not stale: `robot` without waiting."""
        state = self._used.get(robot)
        if state is None or state.stale:
            return None
        self._used.move_to_end(robot)
        return state

    async def robot(self, robot: str) -> Robot:
        """Return a robot's state, read from the store if it is not in memory. NotFound."""
        state = self.states.get(robot)
        if state is not None and not state.stale:
            self._use(state)
            return state
        try:
            async with self._loading.setdefault(robot, asyncio.Lock()):
                state = self.states.get(robot)
                if state is None or state.stale:
                    state = await self._load(robot)
        finally:
            self._loading.pop(robot, None)  # also for names that are no robot, of which there is no end
        return state

    async def take_up_working(self) -> None:
        """Read the robots that work without being asked: those with a board or a period."""
        paging: records.Paging | None = records.Paging(limit=1000)
        while paging is not None:
            page = await self._store.read(robots.page, paging)
            for stored in page.items:
                if stored.config.get("board") or stored.config.get("period_s"):
                    await self.robot(stored.id)
            paging = records.Paging(page.next, 1000) if page.next is not None else None

    def _use(self, state: Robot) -> None:
        """Keep a state in memory, and let go of the one that nobody asked for longest."""
        self._used[state.id] = state
        self._used.move_to_end(state.id)
        while len(self._used) > self._most:
            self._used.popitem(last=False)

    async def latest(self, robot: str) -> Robot:
        """Return a robot's state as the store has it: whatever another instance has acknowledged is in it.

        Its event may be on the way still, so the store is asked.
        """
        asked = newest = await self._newest(robot)
        until = time.monotonic() + WRITE_S
        while True:
            state = await self.robot(robot)  # maybe by a reading that began before we asked
            as_configured = (state.stored.etag, state.model.version) == (newest.etag, newest.model_version)
            if as_configured and state.revision >= asked.revision:
                return state
            left = until - time.monotonic()
            if not as_configured or asked.revision > state.head or left <= 0:
                state.changed_elsewhere()
            else:  # a write of ours is under way: it is this revision, or another instance was faster
                await state.observed.beyond(state.revision, left)
            newest = await self._newest(robot)

    async def _newest(self, robot: str) -> records.Newest:
        try:
            return await self._store.read(robots.newest, robot)
        except NotFound:
            await self.drop(robot)
            raise

    async def drop(self, robot: str) -> None:
        """Let go of a robot that is deleted, and of all who wait for it."""
        self._used.pop(robot, None)
        state = self.states.pop(robot, None)
        await self._left(robot)
        if state is not None:
            state.deleted()

    async def _load(self, robot: str) -> Robot:
        """Read a robot from the store into memory, keeping those who wait for it."""

        def look(
            view: View,
        ) -> tuple[
            records.StoredRobot,
            records.StoredModel,
            records.StoredObs,
            records.StoredDiagnosis | None,
            dict[str, tuple[records.StoredStart, ...]],
        ]:
            stored = robots.get(view, robot)
            return (
                stored,
                models.get(view, stored.config["model"]),
                observations.obs(view, robot),
                diagnoses.latest(view, robot),
                start_ups.of(view, robot),
            )

        try:
            stored, model, obs, diagnosed, took = await self._store.read(look)
        except NotFound:
            await self.drop(robot)
            raise
        system = await self._models.compiled(model)
        config = RobotConfig.from_json(robot, stored.config)
        words = Words.of(model, system, config)
        assertions = [
            assertion
            for record in obs.assertions
            if (assertion := await stored_assertion(robot, record, words, self._models.readers)) is not None
        ]
        state = self.states.get(robot)
        if state is None:
            state = self.states[robot] = Robot(stored, model, system, self.robot)
        self._use(state)
        state.read(stored, model, system, obs, assertions, diagnosed, took)
        await self._taken_up(state)
        return state
