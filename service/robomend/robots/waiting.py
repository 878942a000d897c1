"""Those who wait for a diagnosis: long polls, requests that want the newest one, the repair loop."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from robomend.diagnosis.result import DiagnosisResult
from robomend.errors import Overloaded
from robomend.metrics import Metrics
from robomend.robots.diagnosing import Diagnosing
from robomend.robots.robot import Robot

SETTLE_S = 0.1
"""How long an answer waits for a diagnosis that is under way; a small model's takes a hundredth of it."""

LOOK_S = 0.25
"""How often a wait looks again, for a change that was lost with its database connection."""


class Waiting:
    """See the module. Belongs to one event loop."""

    def __init__(self, diagnosing: Diagnosing, metrics: Metrics, most: int) -> None:
        """`most` requests may be in a long poll."""
        self._diagnosing = diagnosing
        self._metrics = metrics
        self._most = most
        self.requests = 0
        metrics.on_demand("robomend_waiting", "requests in a long poll", (), lambda: [((), self.requests)])

    async def beyond(self, robot: Robot, after: int | None, timeout_s: float) -> None:
        """Return when there is a diagnosis of a revision newer than `after`, or than the current one.

        Raises:
            Overloaded: too many wait already.
        """
        deadline = time.monotonic() + timeout_s
        count = robot.diagnosed.value
        async with self.counted():
            if robot.stale:  # another instance knows more
                self._diagnosing.wake(robot)
            while not (self._diagnosing.closing or robot.gone):
                if after is not None and robot.current is not None and robot.current.revision > after:
                    return
                left = deadline - time.monotonic()
                now = await robot.diagnosed.beyond(count, left) if left > 0 else count
                if left <= 0 or (after is None and now > count):
                    return
                count = now

    async def settled(self, robot: Robot) -> None:
        """Have the diagnosis of OBS as it is now, or a newer one, if that is to be had in a moment.

        A small model's is made here and now, before it is published: whoever asks need not wait for the disk.
        Others are waited for a little, and so are writes under way, which memory has already.
        """
        revision, deadline = robot.revision, time.monotonic() + SETTLE_S
        while not (self._diagnosing.closing or robot.gone or _is_diagnosed(robot, revision)):
            left = deadline - time.monotonic()
            if robot.stale:  # another instance was faster
                if left <= 0:
                    return
                await robot.refreshed()
            elif not robot.writing and (current := self._diagnosing.at_once(robot, robot.revision)):
                robot.looked_up(current)
            elif left <= 0 or not (robot.writing or robot.diagnosing):
                return
            elif robot.writing:
                await robot.observed.beyond(robot.revision, left)
            else:
                await robot.diagnosed.beyond(robot.diagnosed.value, left)

    async def result(self, robot: Robot) -> DiagnosisResult:
        """Return the diagnosis of OBS as it is now, once there is one; a fault in its place is raised."""
        while True:
            await robot.refreshed()
            current = robot.current
            if current is not None and current.answer is not None and current.revision >= robot.revision:
                return current.answer.result_or_fault()
            count = robot.diagnosed.value
            if not robot.diagnosing:
                self._diagnosing.wake(robot)
            await robot.diagnosed.beyond(count, LOOK_S)

    @asynccontextmanager
    async def counted(self) -> AsyncIterator[None]:
        """Count a request that waits. Overloaded when there are too many."""
        if self.requests >= self._most:
            self._metrics.refused.labels("waiters").inc()
            raise Overloaded(f"{self.requests} requests wait already; that is the limit")
        self.requests += 1
        try:
            yield
        finally:
            self.requests -= 1


def _is_diagnosed(robot: Robot, revision: int) -> bool:
    """Return whether the current diagnosis is of this revision of OBS, or a newer one, and of this model."""
    current = robot.current
    return (
        current is not None and current.revision >= revision and current.model_version == robot.model.version
    )
