"""The exemplars of other people as suites of the score: SUNSET and SUAVE, `robomend-bench faults --exemplar`.

    the managed system, simulated ──► the observers of examples/NAME/agent.yaml ──► reports ──► the service
                  ▲                                                                                │
                  └────────────── acts ◄── the agent ◄───────────────────────────────────────────┘

The service is the real one, with the model and the robot of examples/NAME; time is real. Beside SUNSET stands
the selection of strategies of its authors, on a simulated clock that costs it nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import yaml

from robomend.resources import resource
from robomend_bench.faults.agents import HostAgent
from robomend_bench.faults.anatomy import Anatomy, Aspect, Node
from robomend_bench.faults.condition import Act
from robomend_bench.faults.observing import PRESETS, HostObservers
from robomend_bench.faults.suave import ACTS as SUAVE_ACTS
from robomend_bench.faults.suave import LASTS_S, Suave
from robomend_bench.faults.sunset import ACTS as SUNSET_ACTS
from robomend_bench.faults.sunset import Options, Strategy, Sunset, Triple, scenarios, with_rival
from robomend_bench.service.process import served
from robomend_client.actions import ActionResult
from robomend_client.literals import parse_atom
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.errors import ClientError

TICK_S = 0.02
READY_S = 60.0
MOST_S = 60.0
"""Of a scenario, from its faults."""

QUIET_S = 3.0
"""So long after all was clear, strategies still count: what was done then was not needed."""


class Managed(Protocol):
    """A managed system; its time is passed in."""

    messages: list[tuple[str, float, Mapping[str, object]]]

    def advance(self, now_s: float) -> None:
        """Let time pass."""
        ...

    def running(self) -> frozenset[str]:
        """Return the nodes whose processes are there."""
        ...

    def begin(self, act: Act) -> float:
        """Begin an act; return how long it takes until its answer."""
        ...

    def code(self, act: Act) -> int:
        """Return the answer of an act that has ended."""
        ...


@dataclass(frozen=True)
class Exemplar:
    """What the service and the agent are told of a managed system."""

    name: str
    model: Mapping[str, Any]
    robot: Mapping[str, Any]
    observers: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, name: str) -> Exemplar:
        """Return one of the examples."""
        model, robot, agent = (
            yaml.safe_load(resource("examples", f"{name}/{file}.yaml").read_text(encoding="utf-8"))
            for file in ("model", "robot", "agent")
        )
        return cls(name, model, robot, agent["observers"])

    @property
    def anatomy(self) -> Anatomy:
        """The robot as its observers see it: each entry of the agent's file is an observer."""
        usual = {"general": "topic", "diagnostic": "atom"}
        aspects = []
        for name, said in self.observers.items():
            observer = {key: value for key, value in said.items() if key != "from"}
            if (kind := observer["kind"]) == "node":
                continue  # they have one of their own
            if kind in usual:
                observer.setdefault(usual[kind], name)
            if kind == "diagnostic":
                observer["source"] = "diagnostics:status"
            if ".py:" in kind:
                observer["kind"] = str(
                    resource("examples", f"{self.name}/{kind.partition(':')[0]}").parent / kind
                )
            aspects.append(Aspect(parse_atom(name), observer))
        nodes = {name: Node(name) for name in self.model["nodes"]}
        return Anatomy({}, nodes, {}, tuple(aspects))


class LiveExemplar:
    """A managed system in real time, with its agent."""

    def __init__(
        self,
        id: str,
        exemplar: Exemplar,
        system: Managed,
        acts: Sequence[Act],
        clients: tuple[AsyncClient, AsyncClient],
        folder: Path,
    ) -> None:
        self.id = id
        self._exemplar = exemplar
        self._system = system
        self._client = clients[0]
        self._zero_s = time.monotonic()
        self._agent = HostAgent(id, None, clients, folder, acts, self._carry_out)

    @property
    def now_s(self) -> float:
        """The time of the system."""
        return time.monotonic() - self._zero_s

    async def run(self) -> None:
        """Let its time pass, and report, until cancelled."""
        epoch_s = time.time() - self.now_s
        observers = HostObservers(self._exemplar.anatomy, None, PRESETS["fast"], self.now_s, epoch_s=epoch_s)
        self._agent.start(observers)
        try:
            while True:
                self._system.advance(self.now_s)
                for topic, at_s, values in self._system.messages:
                    if topic in observers.topics:
                        observers.message(topic, at_s, values)
                self._system.messages.clear()
                changes = observers.check(self.now_s, self._system.running(), {})
                if changes and self._agent.reporter is not None:
                    self._agent.reporter.report(changes)
                await asyncio.sleep(TICK_S)
        finally:
            await self._agent.stop()

    async def _carry_out(self, act: Act, agent: str) -> ActionResult:
        self._system.advance(self.now_s)
        await asyncio.sleep(self._system.begin(act))
        self._system.advance(self.now_s)
        return ActionResult(self._system.code(act), "")

    async def ready(self) -> None:
        """Wait until every node and every topic was reported, and the robot is healthy."""
        wanted = {*self._exemplar.robot["observed"]}
        deadline = time.monotonic() + READY_S
        while True:
            obs = await self._client.observations(self.id)
            held = {entry["literal"] for entry in obs["observations"] if entry["fresh"]}
            result = (await self._client.diagnosis(self.id))["result"]
            if wanted <= held and result is not None and not result["diagnoses"][0]["bad"]:
                return
            if time.monotonic() > deadline:
                why = f"missing {sorted(wanted - held)}" if result else "no diagnosis"
                raise TimeoutError(f"{self.id} was not healthy in {READY_S:g} s: {why}")
            await asyncio.sleep(0.2)

    async def left_alone(self) -> tuple[str, ...]:
        """Return the components that the service leaves alone for a while."""
        return tuple(sorted(await self._client.quarantine(self.id)))

    async def forget(self) -> None:
        """Take it away from the service."""
        for _ in range(40):
            open_ = (await self._client.all_repairs(open_only=True))["items"]
            for repair in (one for one in open_ if one["robot"] == self.id):
                with contextlib.suppress(ClientError):
                    await self._client.cancel(repair["id"], "the scenario is over")
            with contextlib.suppress(ClientError):  # the repair is still ending
                await self._client.delete_robot(self.id, "*")
                return
            await asyncio.sleep(0.25)


@asynccontextmanager
async def live(
    url: str, id: str, exemplar: Exemplar, system: Managed, acts: Sequence[Act], folder: Path
) -> AsyncIterator[LiveExemplar]:
    """Have a managed system at the service, healthy and reported."""
    async with AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(AsyncClient(url, timeout_s=30.0)) for _ in range(2)]
        with contextlib.suppress(ClientError):  # it is there already
            await clients[0].put_model(exemplar.robot["model"], yaml.safe_dump(dict(exemplar.model)))
        await clients[0].put_robot(id, exemplar.robot)
        robot = LiveExemplar(id, exemplar, system, acts, (clients[0], clients[1]), folder / id)
        running = asyncio.create_task(robot.run())
        try:
            await robot.ready()
            yield robot
            if running.done():
                running.result()
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
            await robot.forget()


# --- SUNSET


@dataclass(frozen=True)
class Outcome:
    """What came of one scenario."""

    triple: Triple
    clear_s: float | None  # None: it never was
    strategies: tuple[Strategy, ...]

    @classmethod
    def of(cls, triple: Triple, system: Sunset) -> Outcome:
        """Return what came of a system, up to QUIET_S after all was clear."""
        until_s = math.inf if system.clear_s is None else system.clear_s + QUIET_S
        done = tuple(s for s in system.strategies if system.began_s <= s.at_s <= until_s)
        return cls(triple, None if system.clear_s is None else system.clear_s - system.began_s, done)

    def lines(self) -> Iterator[str]:
        """Yield what was done, for people."""
        end = "never clear" if self.clear_s is None else f"clear after {self.clear_s:.1f} s"
        yield f"{', '.join(self.triple)}: {end}"
        for one in self.strategies:
            said = "wrong component" if one.wrong else "needless" if one.needless else ""
            yield f"    {one.at_s:6.1f} {one.act} {said}".rstrip()


def told_as_the_rival() -> Exemplar:
    """Return SUNSET without what the rival is not told: whether the camera's picture is dark.

    Whether the picture is dark or shifted, its low quality does not say: the two are as probable as the
    rival's rules have it.
    """
    whole = Exemplar.read("sunset")
    model = {key: value for key, value in whole.model.items() if key != "functions"}
    shown = {"mends": "exposure", "cost": 1, "needs": ["sensor_fusion"]}
    model |= {
        "name": "sunset-told-less",
        "hardware": {"lens": {}, "calibration": {"prior": 0.08}, "exposure": {"prior": 0.012}},
        "properties": {"focused": {}, "low_entropy": {}},
        "rules": [
            "not ab(lens) -> ok(focused)",
            "not ab(calibration) and not ab(exposure) -> ok(low_entropy)",
        ],
        "remedies": {**model["remedies"], "show(enhanced)": shown},
    }
    observers = {n: o for n, o in whole.observers.items() if n != "bright" and not n.startswith("active")}
    robot = {**whole.robot, "model": "sunset-told-less"}
    return replace(whole, model=model, robot=robot, observers=observers)


RIVALS: Mapping[str, Options] = {
    "the rival, no options": Options(),
    "the rival: dependencies, criticality, cost": Options(True, True, True),
    "the same, with a rule for dark pictures": Options(True, True, True, sees_dark=True),
}

OURS: Mapping[str, Callable[[], Exemplar]] = {
    "robomend, told what the rival is": told_as_the_rival,
    "robomend, told of dark pictures": partial(Exemplar.read, "sunset"),
}


async def play_sunset(
    url: str, folder: Path, exemplar: Exemplar, triples: Sequence[Triple], jobs: int
) -> list[Outcome]:
    """Let the service have each scenario, so many side by side."""
    waiting = list(enumerate(triples))[::-1]
    found: dict[int, Outcome] = {}

    async def work(number: int) -> None:
        await asyncio.sleep(0.3 * number)
        while waiting:
            index, triple = waiting.pop()
            system = Sunset()
            id = f"{exemplar.robot['model']}.{index}"
            async with live(url, id, exemplar, system, SUNSET_ACTS, folder) as robot:
                await asyncio.sleep(random.Random(id).uniform(0.2, 1.2))  # at any phase
                system.plant(triple)
                while robot.now_s < system.began_s + MOST_S:
                    await asyncio.sleep(0.1)
                    if system.clear_s is not None and robot.now_s > system.clear_s + QUIET_S:
                        break
            found[index] = Outcome.of(triple, system)

    await asyncio.gather(*(work(number) for number in range(jobs)))
    return [found[index] for index in sorted(found)]


def sunset(count: int, jobs: int) -> dict[str, list[Outcome]]:
    """Return what came of the scenarios, with the rival and with the service."""
    triples = scenarios(count)
    found: dict[str, list[Outcome]] = {}
    for name, options in RIVALS.items():
        systems = with_rival(triples, options)
        found[name] = [Outcome.of(*each) for each in zip(triples, systems, strict=True)]
    with served() as service, tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        # A service that has just started plans its first repair while it still loads what it needs.
        asyncio.run(play_sunset(service.url, Path(folder), Exemplar.read("sunset"), triples[:1], 1))
        for name, exemplar in OURS.items():
            work = play_sunset(service.url, Path(folder), exemplar(), triples, jobs)
            found[name] = asyncio.run(work)
    return found


def sunset_table(rows: Mapping[str, Sequence[Outcome]]) -> Iterator[str]:
    """Yield the table."""
    yield (
        "| | scenarios | strategies | needless | on a wrong component | needless redeployments "
        "| all clear, mean / worst |"
    )
    yield "| --- |" + " ---: |" * 6
    for name, outcomes in rows.items():
        count = len(outcomes)
        done = [one for outcome in outcomes for one in outcome.strategies]
        clear = [outcome.clear_s for outcome in outcomes if outcome.clear_s is not None]
        times = f"{sum(clear) / len(clear):.1f} / {max(clear):.1f} s" if clear else "–"
        times += f", {count - len(clear)} never" if len(clear) < count else ""
        means = (
            len(done),
            sum(one.needless for one in done),
            sum(one.wrong for one in done),
            sum(one.redeployed for one in done),
        )
        yield f"| {name} | {count} | {' | '.join(f'{mean / count:.2f}' for mean in means)} | {times} |"


# --- SUAVE


@dataclass(frozen=True)
class Flight:
    """What came of one mission."""

    wrong_s: float
    recovery_s: float | None  # from the failure of the thruster; None: it never began
    asked: tuple[str, ...]
    left_alone: tuple[str, ...]  # components in quarantine at the end


async def fly(url: str, folder: Path, *, speed: float = 1.0) -> Flight:
    """Let the service have a mission of SUAVE; at a multiple of its speed the dwell is shorter, too."""
    exemplar = Exemplar.read("suave")
    if speed != 1.0:
        functions = {
            name: {**said, "dwell_s": said["dwell_s"] / speed}
            for name, said in exemplar.model["functions"].items()
        }
        exemplar = replace(exemplar, model={**exemplar.model, "functions": functions})
    system = Suave(speed)
    async with live(url, "suave", exemplar, system, SUAVE_ACTS, folder) as robot:
        system.start()
        while system.mission_s < LASTS_S:
            await asyncio.sleep(0.1)
        left_alone = await robot.left_alone()
    failed_s, asked_s = system.failed_s, system.recovering_s
    recovery_s = None if failed_s is None or asked_s is None else asked_s - failed_s
    return Flight(system.wrong_s, recovery_s, tuple(system.asked), left_alone)


def suave_table(flight: Flight) -> Iterator[str]:
    """Yield the table."""
    begun = "never" if flight.recovery_s is None else f"{flight.recovery_s:.1f} s"
    left_alone = ", ".join(flight.left_alone) or "–"
    yield "| wrong altitude, of 110 s | thruster recovery begun after | modes asked for | left alone |"
    yield "| ---: | ---: | ---: | --- |"
    yield f"| {flight.wrong_s:.1f} s | {begun} | {len(flight.asked)} | {left_alone} |"


EXEMPLARS = ("sunset", "suave")


@dataclass(frozen=True)
class Told:
    """What is told of a run."""

    table: tuple[str, ...]
    figures: Mapping[str, Any]
    details: tuple[str, ...] = ()

    def markdown(self) -> str:
        """Return the table, and what was done where that was asked for."""
        return "\n".join((*self.table, *(("", *self.details) if self.details else ())))

    def as_json(self) -> Mapping[str, Any]:
        """Return the figures."""
        return self.figures


def play_exemplar(name: str, *, scenarios: int, jobs: int, verbose: bool = False) -> Told:
    """Play an exemplar with the service.

    Args:
        scenarios: of SUNSET, at most.
        jobs: scenarios side by side.
        verbose: tell what was done in each scenario.
    """
    if name == "suave":
        with served() as service, tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
            flight = asyncio.run(fly(service.url, Path(folder)))
        return Told(
            tuple(suave_table(flight)),
            {"exemplar": name, **asdict(flight)},
            flight.asked if verbose else (),
        )
    rows = sunset(scenarios, jobs)
    details = [
        line
        for says, all_ in rows.items()
        for o in all_
        for line in (f"{says}: {next(o.lines())}", *o.lines())
    ]
    figures = {says: [asdict(one) for one in outcomes] for says, outcomes in rows.items()}
    return Told(
        tuple(sunset_table(rows)), {"exemplar": name, "rows": figures}, tuple(details) if verbose else ()
    )
