"""Planning in the service: the asynchronous front of robomend.planning.planning.

    little work?  ──► planned at once, in a thread, by planners/dijkstra.py: nearly every robot
        │ more than that
    planner asked, in a worker process  ──► answer              within its share of the time
        │ hangs, crashes, runs out of memory: its process is killed
        └──► fallback asked, in a fresh process  ──► answer, or GAVE_UP

To start a worker takes half a second of processor time, on a busy computer many seconds; a small robot's
plan takes milliseconds, and its thread keeps the event loop for 5 ms at a time at most.

The time is processor time of the worker: a computer that has other things to do makes nobody give up. Out of
time is an answer (GAVE_UP); a crash of planner and fallback alike is WorkerDied.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

from robomend.errors import WorkerDied, WorkerTimeout
from robomend.model.components import ComponentModel
from robomend.planning.advice import Situation
from robomend.planning.choice import Choice
from robomend.planning.domain.loading import load_domain
from robomend.planning.plan import Plan
from robomend.planning.planners import FALLBACK, make_planner
from robomend.planning.planning import (
    EVERYDAY,
    PlanOptions,
    gave_up,
    may_be_little,
    plan_for,
    plans_at_once,
    plans_for,
)
from robomend.workers.pool import WorkerPool
from robomend_client.literals import Literal

SHARE = 0.6
"""Of the time, for the planner that was asked; the rest is the fallback's."""

GRACE_S = 0.25
"""What a worker gets beyond a planner's own deadline, to hand in what it has."""

STARVED = 10
"""How many times its processor time a planner may take by the clock: one that sleeps is ended then."""

STARVED_S = 20.0
"""What it may take at least."""

WAITING = 64
"""Plans that wait to be made at once; more go to the workers, whose queue refuses what is too much."""

MEMORY_BYTES = 4 << 30
"""Address space, of which a planner touches about 60 MB."""


LARGE = 500
"""Components, from which on it takes milliseconds to choose: it is done in a thread."""


def warm(planners: Sequence[str] = EVERYDAY) -> None:
    """Load what every call of these planners needs."""
    load_domain()
    for planner in planners:
        make_planner(planner)
    # The first plan is slow: regular expressions, clingo's encoding, Unified Planning's lazy imports.
    from robomend.model.components import Hardware, Node

    tiny = ComponentModel("warm-up", {"h": Hardware("h", 0)}, {"n": Node("n", ("h",))}, {})
    for planner in planners:
        plan_for(tiny, (), ("h",), PlanOptions(planner=planner))


class PlannerPool:
    """Plans in warm processes, with deadlines that hold."""

    def __init__(
        self,
        *,
        size: int = 1,
        spare: int = 1,
        memory_bytes: int | None = MEMORY_BYTES,
        planners: Sequence[str] = EVERYDAY,
        at_once: bool = True,
    ) -> None:
        """Warm nothing yet.

        Args:
            planners: what each process loads at its start. Others are loaded when they are asked for.
            at_once: whether what is little work is planned without a worker.
        """
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="plans-at-once") if at_once else None
        self._waiting = 0
        self._workers = WorkerPool(
            "planner",
            size=size,
            spare=spare,
            warm=partial(warm, tuple(planners)),
            memory_bytes=memory_bytes,
        )

    def start(self) -> None:
        """Warm a process now instead of at the next call; called again and again, it keeps one warm."""
        self._workers.start()

    async def plans(
        self,
        model: ComponentModel,
        observed: Iterable[Literal],
        diagnoses: Sequence[Collection[str]],
        options: PlanOptions,
    ) -> list[Plan]:
        """Return a plan for each diagnosis, those that ran out of time as GAVE_UP.

        Raises:
            InputError: what plan_for refuses.
            WorkerDied: planner and fallback crashed.
            Overloaded: too many calls wait already.
        """
        literals = tuple(observed)
        wanted = [tuple(bad) for bad in diagnoses]
        if self._thread is not None and self._waiting < WAITING and may_be_little(model, options):
            self._waiting += 1
            try:
                found = await asyncio.wrap_future(
                    self._thread.submit(plans_at_once, model, literals, wanted, options)
                )
                if found is not None:
                    return found
            except RuntimeError:  # it is closed, or there is no room for a thread: the workers say so
                pass
            finally:
                self._waiting -= 1
        attempts = _Attempts(options)
        while True:
            try:
                return await self._workers.run(
                    plans_for,
                    model,
                    literals,
                    wanted,
                    attempts.current,
                    timeout_s=attempts.deadline_s,
                    processor_s=attempts.processor_s,
                )
            except (WorkerTimeout, WorkerDied) as error:
                if not attempts.next(error):
                    return attempts.given_up(error, len(wanted))

    def plans_now(
        self,
        model: ComponentModel,
        observed: Iterable[Literal],
        diagnoses: Sequence[Collection[str]],
        options: PlanOptions,
    ) -> list[Plan]:
        """Like `plans`, for code without an event loop."""
        return asyncio.run(self.plans(model, observed, diagnoses, options))

    def close(self) -> None:
        """End every process."""
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)
        self._workers.close()

    async def aclose(self) -> None:
        """Like `close`, without blocking the event loop."""
        await asyncio.to_thread(self.close)

    @property
    def pids(self) -> tuple[int, ...]:
        """The process ids of the workers."""
        return self._workers.pids


class _Attempts:
    """The planner that was asked, then the fallback, within one deadline."""

    def __init__(self, options: PlanOptions) -> None:
        self._options = options
        self._started = time.monotonic()
        alone = options.planner == FALLBACK
        share = options.timeout_s
        if share is not None and not alone:
            share *= SHARE
        self.current = replace(options, timeout_s=share)
        self._left = [] if alone else [FALLBACK]

    @property
    def processor_s(self) -> float | None:
        """After so much processor time the worker is killed."""
        timeout_s = self.current.timeout_s
        return None if timeout_s is None else timeout_s + GRACE_S

    @property
    def deadline_s(self) -> float | None:
        """After so long it is killed, however little of the processor it got."""
        processor_s = self.processor_s
        return None if processor_s is None else max(STARVED_S, STARVED * processor_s)

    def next(self, error: WorkerTimeout | WorkerDied) -> bool:
        """Go on to the fallback; False: nothing is left, or no time."""
        if not self._left:
            return False
        left: float | None = None
        if self._options.timeout_s is not None and self.processor_s is not None:
            spent = self.processor_s  # all of it, or, where it died before, no more than the clock says
            if isinstance(error, WorkerDied):
                spent = min(spent, time.monotonic() - self._started)
            left = self._options.timeout_s - spent
            if left <= 0:
                return False
        self.current = replace(self._options, planner=self._left.pop(), timeout_s=left)
        return True

    def given_up(self, error: WorkerTimeout | WorkerDied, count: int) -> list[Plan]:
        if isinstance(error, WorkerDied):
            raise error
        return [gave_up(self._options.planner, time.monotonic() - self._started)] * count


async def advise(pool: PlannerPool, situation: Situation, options: PlanOptions) -> Choice:
    """Plan for the leading diagnoses in a worker and choose."""
    large = len(situation.result.components) > LARGE
    found = await asyncio.to_thread(lambda: situation.wanted) if large else situation.wanted
    wanted = [one.bad for one in found]
    plans = await pool.plans(situation.model, situation.observed, wanted, options) if wanted else []
    return await asyncio.to_thread(situation.decide, plans) if large else situation.decide(plans)


def advise_now(pool: PlannerPool, situation: Situation, options: PlanOptions) -> Choice:
    """Like `advise`, for code without an event loop."""
    return asyncio.run(advise(pool, situation, options))
