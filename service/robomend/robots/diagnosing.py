"""When a robot is diagnosed, and what becomes of the answer.

    a batch ──► its diagnosis to be had at once? ── yes ──► one transaction for both ──► published
                      │ no: after its write
    a period, ────────┴─► wake ──► one under way, one pending per robot ──► debounce ──► the diagnoser
    a literal that became stale                                                               │
              long polls, the repair loop ◄── published, an event if it says something new ◄──┘

What flaps is debounced: a diagnosis waits until OBS was quiet for a while, but not for ever. A diagnosis
that says the same as the one before is no event; whoever waits for it is told all the same.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from functools import partial

import structlog

from robomend.diagnosis.result import DiagnosisResult
from robomend.errors import NotFound, RobomendError
from robomend.metrics import Metrics
from robomend.robots.clock import CLOCK
from robomend.robots.diagnoser import Current, Diagnosed, Diagnoser, how
from robomend.robots.robot import Robot
from robomend.settings import Settings
from robomend.store import Store, Transaction
from robomend.store.records import IdempotencyKey, Json
from robomend_client.literals import Literal

log = structlog.get_logger("robomend.robots.diagnosing")

FAILED_AGAIN_S = 1.0
"""Pause before a diagnosis that could not be made or written is tried again."""

PATIENCE = 10
"""Times the debounce after which what still flaps is diagnosed nevertheless."""


class Diagnosing:
    """See the module. Belongs to one event loop."""

    def __init__(self, store: Store, settings: Settings, metrics: Metrics, diagnoser: Diagnoser) -> None:
        self._store = store
        self._settings = settings
        self._metrics = metrics
        self._diagnoser = diagnoser
        self._running: set[asyncio.Task[None]] = set()
        self._callbacks: list[Callable[[Robot], None]] = []
        self.closing = False
        metrics.on_demand(
            "robomend_diagnoses_queued", "robots being diagnosed", (), lambda: [((), len(self._running))]
        )

    def on_diagnosis(self, callback: Callable[[Robot], None]) -> None:
        """Call back with a robot after each diagnosis of it, as robot_repairs.py is; it must not block."""
        self._callbacks.append(callback)

    async def close(self) -> None:
        """Stop diagnosing; what was acknowledged is in the store, and is diagnosed after the next start."""
        self.closing = True
        for task in self._running:
            task.cancel()
        if self._running:
            await asyncio.wait(self._running, timeout=5.0)
        self._diagnoser.close()

    # --- a batch comes in

    async def write(
        self, robot: Robot, batch: Callable[[Transaction], Json], once: IdempotencyKey | None
    ) -> Json:
        """Write a batch that memory has already, and return what `batch` does, with its "revision".

        The diagnosis goes into the same transaction if it can be had at once; else the robot is woken after
        it. If the write fails, memory is read again from the store.
        """
        current = self._at_hand(robot, robot.head + 1)
        news = current if current is not None and robot.announces(current) else None
        writing, ran = robot.accepted(), False

        def batch_and_news(tx: Transaction) -> Json:
            nonlocal ran
            ran = True
            said = batch(tx)
            if news is not None:
                news.announce(robot.id, tx)
            return said

        try:
            said = await self._store.write(batch_and_news, robots=(robot.id,), once=once)
        except BaseException:  # a cancellation too: nobody knows then whether it is on disk
            robot.not_kept()
            raise
        robot.kept(writing, said["revision"], repeated=not ran)
        if current is not None and not robot.stale:
            self._metrics.published_s.observe(time.perf_counter() - writing.began)
            self._published(robot, current)
        else:
            self.wake(robot, since=writing.began)
        return said

    def _at_hand(self, robot: Robot, revision: int) -> Current | None:
        """Return the diagnosis of OBS as it is here, that of `revision`, if it can be had without waiting.

        Not while its writes queue up: a burst is still diagnosed once and not for each of its batches.
        """
        busy = robot.diagnosing or robot.writing
        if self.closing or busy or robot.stale or robot.config.debounce_s > 0:
            return None
        return self.at_once(robot, revision)

    def confirm(self, robot: Robot) -> None:
        """A batch said what is known: the diagnosis stands, or is made anew."""
        current = self._at_hand(robot, robot.revision)
        if current is not None and robot.confirms(current):
            self._published(robot, current)
        else:
            self.wake(robot)

    # --- what wakes a robot

    def wake(self, robot: Robot, since: float | None = None) -> None:
        """Have the robot diagnosed: now if nothing is under way, else once more after it.

        `since` (perf_counter): when what is not diagnosed yet came in.
        """
        if not self.closing:
            robot.woken(lambda: self._begin(robot), since)

    def _begin(self, robot: Robot) -> asyncio.Task[None]:
        task = asyncio.create_task(self._diagnose(robot), name=f"diagnosis of {robot.id}")
        self._running.add(task)
        task.add_done_callback(self._running.discard)
        return task

    def set_period(self, robot: Robot) -> None:
        """Wake every so often, where the robot's configuration asks for it (the paper's second)."""
        period_s = robot.config.period_s
        if period_s is None or self.closing:
            robot.cancel_timer("period")
            return

        def turn() -> None:
            self.wake(robot)
            self.set_period(robot)

        robot.wake_later("period", period_s, turn)

    def _set_expiry(self, robot: Robot) -> None:
        """Wake when the next literal becomes stale: stale is unknown, so the diagnosis may change."""
        now = CLOCK.now_ns() if robot.obs.mortal else 0
        expires = robot.obs.next_expiry_ns(now) if now else None
        if expires is not None:
            self._later(robot, "expiry", min((expires - now) / 1e9 + 0.001, 86400.0), self._expired)

    def _expired(self, robot: Robot) -> None:
        robot.changed_elsewhere()  # another instance may have renewed it, which is no event
        self.wake(robot)

    def _later(self, robot: Robot, name: str, delay_s: float, then: Callable[[Robot], None]) -> None:
        if not self.closing:
            robot.wake_later(name, delay_s, partial(then, robot))

    # --- one robot's diagnoses

    async def _diagnose(self, robot: Robot) -> None:
        """Diagnose until nothing is pending."""
        try:
            while robot.diagnosing:
                await _debounce(robot)
                await robot.refreshed()
                began = robot.diagnosis_began()
                answer = await self._diagnosed(robot)
                await self._publish(robot, answer, began)
                robot.diagnosis_came()
        except NotFound:
            log.info("robot gone", robot=robot.id)
        except RobomendError as error:
            log.warning("diagnosis not published", robot=robot.id, code=error.code, detail=str(error))
            self._later(robot, "retry", FAILED_AGAIN_S, self.wake)
        except Exception:  # one robot's unforeseen fault must not end its diagnoses for ever
            log.exception("diagnosis failed", robot=robot.id)
            self._later(robot, "retry", FAILED_AGAIN_S, self.wake)
        finally:
            if robot.diagnosing:
                robot.diagnosis_gave_up()

    async def _diagnosed(self, robot: Robot) -> Current:
        revision, model_version = robot.revision, robot.model.version
        stopped, options = robot.expected_stopped, how(robot.config, self._settings)
        answer = await self._diagnoser.diagnose(*robot.question(), *options)
        if (sure := _sure(robot, answer)) is not None:
            answer = _stands(robot, answer, await self._diagnoser.diagnose(*robot.question(sure), *options))
        return Current.of(revision, model_version, answer, stopped)

    def at_once(self, robot: Robot, revision: int) -> Current | None:
        """Return the diagnosis of OBS as it is here, that of `revision`, if it is to be had at once."""
        options = how(robot.config, self._settings)
        answer = self._diagnoser.at_once(*robot.question(), *options)
        if answer is None:
            return None
        if (sure := _sure(robot, answer)) is not None:
            rest = self._diagnoser.at_once(*robot.question(sure), *options)
            if rest is None:
                return None
            answer = _stands(robot, answer, rest)
        return Current.of(revision, robot.model.version, answer, robot.expected_stopped)

    async def of(self, robot: Robot, literals: Iterable[Literal]) -> DiagnosisResult:
        """Return the diagnosis of these literals instead of all that is known; a fault is raised."""
        answer = await self._diagnoser.diagnose(*robot.question(literals), *how(robot.config, self._settings))
        return answer.result_or_fault()

    async def _publish(self, robot: Robot, current: Current, began: float | None) -> None:
        """Write a diagnosis if it is news; then tell it."""
        if robot.announces(current):
            try:
                await self._store.write(partial(current.announce, robot.id))
            except BaseException:  # a cancellation too
                robot.not_announced()
                raise
            if began is not None:
                self._metrics.published_s.observe(time.perf_counter() - began)
        self._published(robot, current)

    def _published(self, robot: Robot, current: Current) -> None:
        robot.is_diagnosed(current)
        self._set_expiry(robot)
        if not current.healthy and (early := robot.sight.not_back_yet()):
            left_s = (min(early.values()) - CLOCK.now_ns()) / 1e9
            self._later(robot, "not back", max(0.0, left_s) + 0.001, self.wake)
        for callback in self._callbacks:
            callback(robot)


def _sure(robot: Robot, answer: Diagnosed) -> list[Literal] | None:
    """Return what is evidence already, where somebody is blamed and not all is: an output fell with its
    input, which is back, and its observer has not had the time to see whether it is, too.
    """
    early = {} if answer.healthy else robot.sight.not_back_yet()
    return [one for one in robot.literals() if one.atom not in early] if early else None


def _stands(robot: Robot, answer: Diagnosed, sure: Diagnosed) -> Diagnosed:
    """Return the diagnosis until the rest is evidence: that of what is sure; or where that blames nobody, who
    was blamed before.
    """
    before = robot.current
    if not sure.healthy:
        return sure
    if before is None or before.healthy or before.answer is None or before.answer.result is None:
        return answer
    as_now = (robot.model.version, robot.expected_stopped)
    return before.answer if (before.model_version, before.expected_stopped) == as_now else answer


async def _debounce(robot: Robot) -> None:
    """Wait until OBS is quiet, but at most PATIENCE times as long as that takes."""
    quiet_s = robot.config.debounce_s
    if quiet_s <= 0:
        return
    latest = time.perf_counter() + PATIENCE * quiet_s
    while (left := min(robot.quiet_at(quiet_s), latest) - time.perf_counter()) > 0:
        await asyncio.sleep(left)
