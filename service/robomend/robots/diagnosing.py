"""When a robot is diagnosed, and what becomes of the answer.

    a change, a period, a literal that became stale ──► wake ──► one in flight, one pending per robot
                                                                        │ debounce
          long polls, the repair loop ◄── published if it says something new ◄── the diagnoser

What flaps is debounced: a diagnosis waits until OBS was quiet for a while, but not for ever. A diagnosis
that says the same as the one before is no event; whoever waits for it is told all the same.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import structlog

from robomend.diagnosis.result import Options
from robomend.errors import NotFound, Overloaded, RobomendError
from robomend.metrics import Metrics
from robomend.robots.clock import CLOCK
from robomend.robots.diagnoser import Diagnosed, Diagnoser
from robomend.robots.robot import Current, Robot
from robomend.settings import Settings
from robomend.store import Store, Transaction, diagnoses
from robomend.store.encoding import Encoded, to_json
from robomend_client.events import Kind

log = structlog.get_logger("robomend.robots.diagnosing")

FAILED_AGAIN_S = 1.0
"""Pause before a diagnosis that could not be made or written is tried again."""

SETTLE_S = 0.1
"""How long an answer waits for a diagnosis that is under way; a small model's takes a hundredth of it."""

PATIENCE = 10
"""Times the debounce after which what still flaps is diagnosed nevertheless."""


class Diagnosing:
    """See the module. Belongs to one event loop."""

    def __init__(
        self,
        store: Store,
        settings: Settings,
        metrics: Metrics,
        diagnoser: Diagnoser,
        refresh: Callable[[str], Awaitable[Robot]],
    ) -> None:
        """`refresh` reads a stale state again; NotFound when the robot is gone."""
        self._store = store
        self._settings = settings
        self._metrics = metrics
        self._diagnoser = diagnoser
        self._refresh = refresh
        self._running: set[asyncio.Task[None]] = set()
        self._callbacks: list[Callable[[str], None]] = []
        self.waits = 0
        self.closing = False
        metrics.on_demand(
            "robomend_diagnoses_queued", "robots being diagnosed", (), lambda: [((), len(self._running))]
        )
        metrics.on_demand("robomend_waiting", "requests in a long poll", (), lambda: [((), self.waits)])

    def on_diagnosis(self, callback: Callable[[str], None]) -> None:
        """Call back with a robot's id after each diagnosis, new or confirmed; it must not block."""
        self._callbacks.append(callback)

    async def close(self) -> None:
        """Stop diagnosing; what was acknowledged is in the store, and is diagnosed after the next start."""
        self.closing = True
        for task in self._running:
            task.cancel()
        if self._running:
            await asyncio.wait(self._running, timeout=5.0)
        self._diagnoser.close()

    # --- what wakes a robot

    def wake(self, state: Robot) -> None:
        """Have the robot diagnosed: now if nothing is in flight, else once more after it."""
        if self.closing:
            return
        if state.task is not None:
            state.again = True
            return
        state.task = asyncio.create_task(self._diagnose(state), name=f"diagnosis of {state.id}")
        self._running.add(state.task)
        state.task.add_done_callback(self._running.discard)

    def set_period(self, state: Robot) -> None:
        """Wake every so often, where the robot's configuration asks for it (the paper's second)."""
        old = state.timers.pop("period", None)
        if old is not None:
            old.cancel()
        period_s = state.config.period_s
        if period_s is None or self.closing:
            return

        def turn() -> None:
            self.wake(state)
            self.set_period(state)

        state.timers["period"] = asyncio.get_running_loop().call_later(period_s, turn)

    def _set_expiry(self, state: Robot) -> None:
        """Wake when the next literal becomes stale: stale is unknown, so the diagnosis may change."""
        now = CLOCK.now_ns()
        expires = state.obs.next_expiry_ns(now)
        if expires is not None:
            self._later(state, "expiry", min((expires - now) / 1e9 + 0.001, 86400.0))

    def _later(self, state: Robot, name: str, delay_s: float) -> None:
        if self.closing or state.gone:
            return
        old = state.timers.pop(name, None)
        if old is not None:
            old.cancel()
        state.timers[name] = asyncio.get_running_loop().call_later(delay_s, self.wake, state)

    # --- those who wait

    async def wait(self, state: Robot, after: int | None, timeout_s: float) -> None:
        """Return when there is a diagnosis of a revision newer than `after`, or than the current one.

        Raises:
            Overloaded: too many wait already.
        """
        deadline = time.monotonic() + timeout_s
        count = state.diagnosed.value
        async with self.waiting():
            if state.stale:  # another instance knows more
                self.wake(state)
            while not (self.closing or state.gone):
                if after is not None and state.current is not None and state.current.revision > after:
                    return
                left = deadline - time.monotonic()
                now = await state.diagnosed.beyond(count, left) if left > 0 else count
                if left <= 0 or (after is None and now > count):
                    return
                count = now

    async def settle(self, state: Robot, revision: int, deadline: float) -> None:
        """Have the diagnosis of `revision` or a newer one as the current one, if it is to be had in a moment.

        A small model's is made here and now, before it is published: whoever asks need not wait for the disk.
        Others are waited for until the deadline, and so are writes under way, which memory has already.
        """
        while not (self.closing or state.gone or state.stale or _is_current(state, revision)):
            if state.head == state.revision and (answer := self._ask(state)) is not None:
                stopped = state.config.expected_stopped
                state.current = _current(state.revision, state.model.version, answer, stopped)
                return
            left = deadline - time.monotonic()
            if left <= 0:
                return
            if state.head != state.revision:
                await state.observed.beyond(state.revision, left)
                continue
            if state.task is None:
                return
            await state.diagnosed.beyond(state.diagnosed.value, left)

    @asynccontextmanager
    async def waiting(self) -> AsyncIterator[None]:
        """Count a request that waits. Overloaded when there are too many."""
        if self.waits >= self._settings.max_waiters:
            self._metrics.refused.labels("waiters").inc()
            raise Overloaded(f"{self.waits} requests wait already; that is the limit")
        self.waits += 1
        try:
            yield
        finally:
            self.waits -= 1

    # --- one robot's diagnoses

    async def _diagnose(self, state: Robot) -> None:
        """Diagnose until nothing is pending."""
        try:
            while True:
                await _debounce(state)
                state.again = False
                if state.stale:
                    await self._refresh(state.id)
                    state.again = False
                await self._diagnose_once(state)
                self._tell(state)
                if not state.again:
                    return
        except NotFound:
            log.info("robot gone", robot=state.id)
        except RobomendError as error:
            log.warning("diagnosis not published", robot=state.id, code=error.code, detail=str(error))
            self._later(state, "retry", FAILED_AGAIN_S)
        except Exception:  # one robot's unforeseen fault must not end its diagnoses for ever
            log.exception("diagnosis failed", robot=state.id)
            self._later(state, "retry", FAILED_AGAIN_S)
        finally:
            state.task = None

    async def _diagnose_once(self, state: Robot) -> None:
        began, state.waiting_since = state.waiting_since, None
        revision, model_version = state.revision, state.model.version
        stopped = state.config.expected_stopped
        version, system, literals = state.question()
        options = _options(state, self._settings)
        answer = await self._diagnoser.diagnose(version, system, literals, state.config.engine, options)
        current = _current(revision, model_version, answer, stopped)
        if not same(state.announced, current):
            state.announced = current
            try:
                await self._store.write(partial(announce, state.id, current))
            except BaseException:  # a cancellation too: it was not said, so it is still news
                state.announced = None
                raise
            if began is not None:
                self._metrics.published_s.observe(time.perf_counter() - began)
        self._accept(state, current)

    def at_once(self, state: Robot, revision: int) -> Current | None:
        """Return the diagnosis of OBS as it will be at `revision`, if it can be had without waiting.

        Then it is written in the transaction of the batch that it explains: one commit instead of two. Not
        while the robot's writes queue up, so that a burst is still diagnosed once and not for each of its
        batches.
        """
        busy = state.task is not None or state.head != state.revision
        if self.closing or busy or state.stale or state.config.debounce_s > 0:
            return None
        answer = self._ask(state)
        if answer is None:
            return None
        return _current(revision, state.model.version, answer, state.config.expected_stopped)

    def _ask(self, state: Robot) -> Diagnosed | None:
        version, system, literals = state.question()
        options = _options(state, self._settings)
        return self._diagnoser.at_once(version, system, literals, state.config.engine, options)

    def announced(self, state: Robot, current: Current, waited_s: float) -> None:
        """Take note of a diagnosis from `at_once` that is on disk now."""
        self._metrics.published_s.observe(waited_s)
        self._accept(state, current)
        self._tell(state)

    def _accept(self, state: Robot, current: Current) -> None:
        if state.current is None or current.revision >= state.current.revision:
            state.current = current
        state.diagnosed.advance(state.diagnosed.value + 1)
        self._set_expiry(state)

    def _tell(self, state: Robot) -> None:
        for callback in self._callbacks:
            callback(state.id)


def announce(robot: str, current: Current, tx: Transaction) -> None:
    """Write a diagnosis that says something new, and its event."""
    data = event_data(current)
    diagnoses.record(tx, robot, current.revision, data, model_version=current.model_version)
    tx.emit(Kind.DIAGNOSIS, robot, data)


def event_data(current: Current) -> Encoded:
    """Return what table and event hold of a diagnosis; the result's text was made with the answer."""
    data = {
        "revision": current.revision,
        "model_version": current.model_version,
        "result": current.result,
        "fault": current.fault,
        "expected_stopped": list(current.expected_stopped),
    }
    if current.answer is None or current.answer.text is None:
        return Encoded(data)
    rest = to_json({name: value for name, value in data.items() if name != "result"})
    return Encoded(data, f'{rest[:-1]},"result":{current.answer.text}}}')


def _current(revision: int, model_version: str, answer: Diagnosed, stopped: tuple[str, ...]) -> Current:
    fault = None if answer.fault is None else {"code": answer.fault.code, "detail": str(answer.fault)}
    return Current(revision, model_version, time.time_ns(), answer.json, fault, answer, stopped)


def _is_current(state: Robot, revision: int) -> bool:
    """Return whether the current diagnosis is of this revision of OBS, or a newer one, and of this model."""
    current = state.current
    return (
        current is not None and current.revision >= revision and current.model_version == state.model.version
    )


async def _debounce(state: Robot) -> None:
    """Wait until OBS is quiet, but at most PATIENCE times as long as that takes."""
    quiet_s = state.config.debounce_s
    if quiet_s <= 0:
        return
    latest = time.perf_counter() + PATIENCE * quiet_s
    while (left := min(state.changed_at + quiet_s, latest) - time.perf_counter()) > 0:
        await asyncio.sleep(left)


def _options(state: Robot, settings: Settings) -> Options:
    config = state.config
    return Options(
        minimal="cardinality" if config.minimal == "cardinality" else "subset",
        max_size=config.max_size,
        limit=config.limit,
        timeout_s=min(config.timeout_s or settings.solver_timeout_s, settings.max_solver_timeout_s),
    )


def published(revision: int, time_ns: int, data: Mapping[str, Any]) -> Current:
    """Return a diagnosis that was made by another instance, or before a restart."""
    version = data.get("model_version") or ""
    stopped = tuple(data.get("expected_stopped", ()))
    return Current(revision, version, time_ns, data.get("result"), data.get("fault"), None, stopped)


def same(old: Current | None, new: Current) -> bool:
    """Return whether a diagnosis says the same as the one before, whatever time it took."""
    if old is None or old.fault != new.fault or old.model_version != new.model_version:
        return False
    if old.expected_stopped != new.expected_stopped:
        return False
    if old.answer is not None and new.answer is not None:
        return old.answer.key == new.answer.key
    if old.result is None or new.result is None:
        return old.result is new.result
    return {**old.result, "elapsed_s": 0} == {**new.result, "elapsed_s": 0}
