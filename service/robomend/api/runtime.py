"""The parts of one service, started in order and closed in the other: what `robomend serve` and tests run.

store ──► workers ──► fleet ──► repairs ──► hub ──► the application
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import asdict

import structlog
from fastapi import FastAPI

from robomend.api.app import create_app
from robomend.api.deps import Parts
from robomend.api.shedding import LoadShedding
from robomend.api.store_probe import LoopWatch, StoreProbe
from robomend.api.streams import Hub
from robomend.batches.batches import Batches
from robomend.drills.drills import Drills
from robomend.drills.one_drill import DrillNeeds
from robomend.errors import RobomendError
from robomend.metrics import Metrics
from robomend.notifications.notifier import Notifier
from robomend.oneshots.oneshots import OneShots
from robomend.oneshots.solvers import SolverWorkers
from robomend.planning.planner_pool import PlannerPool
from robomend.repairs.repairs import Repairs
from robomend.repairs.states import ChangeState, RepairState, StepState
from robomend.robots.diagnoser import Diagnoser
from robomend.robots.readers import Readers
from robomend.robots.robots import Robots
from robomend.settings import Settings
from robomend.store import Store, api_keys, opened, pruning
from robomend.store.records import Retention, StoreFigures
from robomend_client.events import Event, Kind

log = structlog.get_logger("robomend")

ACTED = frozenset({StepState.DONE, StepState.FAILED})
"""States in which a step ends whose action was counted: one that was already there sent none."""

PRUNE_S = 600.0
"""Between two prunings; the first comes with the start."""

MakeRepairs = Callable[[Store, Robots, PlannerPool, OneShots, Settings], Repairs]


class Runtime:
    """One service, not yet started. Nothing is opened before `lifespan`."""

    def __init__(self, settings: Settings, make_repairs: MakeRepairs) -> None:
        self.settings = settings
        self.metrics = Metrics()
        self.store = Store(settings.database_url)
        self.solver = SolverWorkers(settings.solver_workers, settings.one_shots + 64)
        self.planners = PlannerPool(size=settings.planner_workers)
        diagnoser = Diagnoser(settings, self.metrics, self.solver)
        self.readers = Readers(settings)
        self.robots = Robots(self.store, settings, self.metrics, diagnoser, self.readers)
        self.one_shots = OneShots(self.solver, self.planners, settings)
        self.hub = Hub(self.store, self.metrics, most=settings.max_streams, ping_s=settings.ping_s)
        self.repairs = make_repairs(self.store, self.robots, self.planners, self.one_shots, settings)
        self.notifier = Notifier(self.store, settings, self.metrics)
        self.drills = Drills(
            DrillNeeds(self.store, self.robots, self.repairs.agents, self.repairs.switch, settings)
        )
        self.batches = Batches(self.store, settings)
        self.watch = LoopWatch(self.metrics)
        self.probe = StoreProbe(self.store)
        shedding = LoadShedding(self.store.oldest_queued_s, lambda: self.watch.delay_s, self.metrics)
        self.parts = Parts(
            settings,
            self.store,
            self.robots,
            self.repairs,
            self.drills,
            self.one_shots,
            self.hub,
            self.metrics,
            self.watch,
            self.probe,
            shedding,
            self.notifier,
            self.batches,
        )
        self.app: FastAPI = create_app(self.parts, lifespan=self.lifespan)
        self._watch_store()

    def end_waits(self) -> None:
        """End streams and long polls, so that a server that shuts down need not wait for them."""
        self.hub.close()
        self.robots.end_waits()
        self.repairs.end_waits()

    @asynccontextmanager
    async def lifespan(self, _: FastAPI) -> AsyncIterator[None]:
        """Start the parts, and close them whatever happens."""
        async with AsyncExitStack() as stack:
            self.watch.start()
            stack.callback(self.watch.close)
            await self.store.start()
            stack.push_async_callback(self.store.close)
            stack.push_async_callback(self.planners.aclose)
            stack.push_async_callback(self.solver.close)
            stack.push_async_callback(self.readers.close)
            stack.callback(self.one_shots.close)
            self.probe.start()
            stack.callback(self.probe.close)
            self.hub.start()
            stack.callback(self.store.subscribe(self._count, (Kind.REPAIR, Kind.CONFIGURATION, Kind.ACTION)))
            pruning = asyncio.create_task(self._prune(), name="retention")
            stack.callback(pruning.cancel)
            stack.push_async_callback(self.robots.close)
            await self.robots.start()
            stack.push_async_callback(self.repairs.close)
            await self.repairs.start()
            stack.push_async_callback(self.notifier.close)
            await self.notifier.start()
            stack.push_async_callback(self.drills.close)
            await self.drills.start()
            stack.push_async_callback(self.batches.close)
            await self.batches.start()
            stack.callback(self.end_waits)
            await self._learn_keys()
            self._begin_counting()
            log.info("ready", database=self.store.url)
            yield
            log.info("closing")

    async def _learn_keys(self) -> None:
        """Know the keys from the start, for a stop while the database does not answer."""
        ring = self.app.state.gate.ring
        await ring.refresh()
        ring.forget()  # the first request reads them again

    def _begin_counting(self) -> None:
        """Count from 0: of a series that begins with 1, Prometheus sees no increase."""
        for state in RepairState:
            self.metrics.repairs.labels(state)
        for of in ("frames", "recordings"):
            self.metrics.moment_bytes.labels(of)
        for change in ChangeState:
            self.metrics.changes.labels(change)

    def _count(self, events: Sequence[Event]) -> None:
        for event in events:
            if event.kind is Kind.REPAIR and event.data.get("drill") is None:
                self.metrics.repairs.labels(str(event.data.get("state"))).inc()
            elif event.kind is Kind.CONFIGURATION and not {"asked", "held"} & event.data.keys():
                self.metrics.changes.labels(str(event.data.get("state"))).inc()
            elif event.kind is Kind.ACTION and "repair" in event.data and event.data.get("state") in ACTED:
                self.metrics.actions.labels(str(event.data.get("name")), str(event.data.get("result"))).inc()

    async def _prune(self) -> None:
        """Remove what is older than the settings keep, at the start and then now and then."""
        retention = kept_by(self.settings)
        while True:
            try:
                log.info("pruned", **asdict(await pruning.prune(self.store, retention)))
            except RobomendError as error:
                log.warning("not pruned", code=error.code, detail=str(error))
            await asyncio.sleep(PRUNE_S)

    def _watch_store(self) -> None:
        def watch(name: str, text: str, read: Callable[[StoreFigures], float]) -> None:
            self.metrics.on_demand(
                f"robomend_store_{name}", text, (), lambda: [((), read(self.store.figures()))]
            )

        watch("queued_writes", "writes that wait", lambda figures: figures.queued_writes)
        watch("oldest_write_seconds", "how long the oldest waits", lambda figures: figures.oldest_write_s)
        watch("commit_seconds", "the last commit", lambda figures: figures.last_commit_s)
        watch("writes", "writes committed since the start", lambda figures: figures.writes)
        watch("commits", "transactions since the start", lambda figures: figures.commits)


def kept_by(settings: Settings) -> Retention:
    """Return how long what is kept."""
    return Retention(
        observations_days=settings.observations_days,
        diagnoses_days=settings.diagnoses_days,
        events_days=settings.events_days,
        repairs_days=settings.repairs_days,
        moments_days=settings.moments_days,
    )


async def any_key(settings: Settings) -> bool:
    """Return whether a key was ever created in this database."""
    async with opened(settings.database_url) as store:
        return bool(await store.read(api_keys.every))
