"""One trial, from an empty robot to its record.

    healthy and heard ──► faults ──► … until nothing has happened for a while, or `most_s` is over

Afterwards the robot is taken away from the service again.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from robomend_bench.faults.body import LIVES_S
from robomend_bench.faults.classes import Planted, Reporting, Scenario, draw
from robomend_bench.faults.field import BY_NAME, world_of
from robomend_bench.faults.kinds import AGAIN, PASSING
from robomend_bench.faults.live import LiveRobot
from robomend_bench.faults.observing import PRESETS, SLOWEST_HZ, Preset, aspects_delay_s
from robomend_bench.faults.record import ENDED, Record, Trial
from robomend_bench.faults.robot import Robot, find_robot, varied
from robomend_bench.faults.stretches import STRETCH_BY_NAME, Stretch, boot
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.errors import ClientError

if TYPE_CHECKING:
    from robomend_bench.faults.bench import Bench  # which plays trials


import re
from collections.abc import Collection, Iterable, Iterator, Mapping

from robomend.repairs.conclusions import ALL_WELL, NAMED
from robomend.repairs.execution_values import Ending
from robomend.repairs.states import RepairState, StepState

# --- whether what a repair says of itself is what happened, beside its record and what was observed.
#
# A reason is put together while a repair runs, from what each part of it knows then; the record and the
# history are what a person finds the next morning. Where the two say different things, one of them is
# wrong, and nobody believes either. Here each repair that has ended is looked at.

Json = Mapping[str, Any]

FINISHED = frozenset({StepState.DONE, StepState.ALREADY})


def contradictions(repair: Json, observed: Collection[str] = ()) -> list[str]:
    """Return where a repair that has ended contradicts itself, in words; nothing if nowhere.

    Args:
        repair: as HTTP shows it, with its steps.
        observed: the literals that OBS held when it ended, as text, as far as they are known.
    """
    return [*_of_the_end(repair, observed), *_of_the_rounds(repair)]


def _of_the_end(repair: Json, observed: Collection[str]) -> Iterator[str]:
    state, reason = RepairState(repair["state"]), str(repair["reason"])
    failing = sorted(one for one in observed if one.startswith("not "))
    if not reason:
        yield f"{state} for no reason"
    if state is RepairState.REPAIRED:
        if any(one not in reason for one in failing[:NAMED]):
            yield f"repaired, but OBS has {', '.join(failing)}, of which the reason says nothing"
        if any(step["state"] == StepState.RUNNING for step in _steps(repair)):
            yield "repaired, and a step is under way"
    elif ALL_WELL in reason:
        yield f"{state}, and {ALL_WELL}"
    left = re.findall(r"; left (?:off|stopped): ([\w, ./-]+)", reason)
    for name in {name for names in left for name in names.split(", ")} - set(repair["left_off"]):
        yield f"{name} is left off in the reason and not in the record"
    for text, times in re.findall(r"([\w-]+\([^()]*\)): it was done (\d+) times", reason):
        sent = sum(_times(step) for step in _steps(repair) if step["text"] == text)
        if sent < int(times):
            yield f"{text} was done {times} times in the reason and {sent} times in the record"
    for text, names in re.findall(r"([\w-]+\([^()]*\)) answered 'done', but (.+?) (?:was|were) not", reason):
        if not any(step["text"] == text and _lacks(step, names) for step in _steps(repair)):
            yield f"the record has no {text} of which {names} was not seen"


def _of_the_rounds(repair: Json) -> Iterator[str]:
    for number, one in enumerate(repair["rounds"], start=1):
        where, steps = f"round {number}", one["plan"]
        undone = [step["text"] for step in steps if step["state"] not in FINISHED]
        lacking = [step["text"] for step in steps if step.get("missing")]
        if one["ending"] is None:
            yield f"{where} has no end"
        if one["ending"] == Ending.DONE and (undone or lacking):
            yield f"{where} is done, but not {', '.join([*undone, *lacking])}"
        if one["ending"] == Ending.EFFECT_MISSING and not lacking:
            yield f"{where} ended as an effect was missing, and none is"
        if one["ending"] == Ending.ACTION_FAILED and not any(
            step["state"] == StepState.FAILED and step["result"] != 0 for step in steps
        ):
            yield f"{where} ended as an action failed, and none did"
        for step in steps:
            yield from (f"{where}: {why}" for why in _of_a_step(step))
    last = repair["rounds"][-1] if repair["rounds"] else None
    if last is not None and repair["state"] == RepairState.REPAIRED and last["ending"] == Ending.HALTED:
        yield "repaired, though its last round was halted"


def _of_a_step(step: Json) -> Iterator[str]:
    text, missing = step["text"], set(step.get("missing", ()))
    if both := sorted(missing.intersection(step.get("seen", ()))):
        yield f"{text}: {', '.join(both)} was seen and was missing"
    if step["state"] == StepState.DONE and step["result"] != 0 and not step.get("seen"):
        yield f"{text} is done, though its action ended with {step['result']} and nothing was seen of it"
    sent_ns, ended_ns = step.get("sent_ns"), step.get("ended_ns")
    if sent_ns and ended_ns and ended_ns < sent_ns:
        yield f"{text} ended before it was sent"


def _lacks(step: Json, names: str) -> bool:
    missing = set(step.get("missing", ()))
    told = set(re.findall(r"(?:not )?\w+\([^()]*\)", names))
    return bool(told) and told <= missing


def _steps(repair: Json) -> Iterable[Json]:
    return (step for one in repair["rounds"] for step in one["plan"])


def _times(step: Json) -> int:
    if step.get("sent_ns") is None:
        return 0
    return 1 + int(str(step.get("id") or "").partition(":")[2].partition(".")[2] or 0)


READY_S = 60.0
"""How long a robot may take to be found healthy before its fault; it takes two or three."""

LOOK_S = 0.05

ASK_S = 1.0
"""How often somebody asks how a robot is."""

AGAIN_S = 3.0
"""For what is announced to be tried again, to begin."""

TIMEOUT_S = 30.0
"""Of a request; one that is sent again as the computer was busy would find what the first one made."""


class NotHealthy(Exception):
    """The robot was never found healthy: the trial could not begin."""


@dataclass(frozen=True, slots=True)
class Terms:
    """What holds for all trials of a run."""

    observers: str = "published"
    most_s: float = 60.0  # of a trial, from its first fault
    accounts: bool = False  # whether the service is asked for its account of each repair
    boots: bool = False  # whether the service sees the robot being switched on before its fault
    topics_hz: float | None = None  # the rate of all topics of all robots; None: each its own

    @property
    def preset(self) -> Preset:
        return PRESETS[self.observers]

    @property
    def quiet_s(self) -> float:
        """A trial is over when nothing has happened for so long: anything would be noticed by then."""
        slowest_hz = SLOWEST_HZ if self.topics_hz is None else self.topics_hz
        return self.preset.delay_s(slowest_hz) + 2.0


@cache
def scenario_of(trial: Trial) -> Scenario:
    """Return the scenario of a trial; that of a stretch has no faults. It may take a while to draw."""
    anatomy, chance = find_robot(trial.robot).anatomy, random.Random(f"scenario {trial}")
    if trial.cls in STRETCH_BY_NAME:
        return STRETCH_BY_NAME[trial.cls].scenario(anatomy, chance)
    return draw(BY_NAME[trial.cls], anatomy, chance)


@cache
def robot_of(trial: Trial, topics_hz: float | None = None) -> Robot:
    """Return the robot of a trial, as its scenario has it."""
    stretch = STRETCH_BY_NAME.get(trial.cls)
    world = world_of(trial.cls) if stretch is None else stretch.world
    return varied(find_robot(trial.robot, topics_hz), scenario_of(trial), world)


async def play(trial: Trial, terms: Terms, around: Bench, number: int) -> Record:
    """Play a trial and return its record; what went wrong on our side is the record's `error`."""
    record = Record(trial, terms.observers)
    scenario = scenario_of(trial)
    record.blind = scenario.blind
    try:
        robot = robot_of(trial, terms.topics_hz)
        most_s = READY_S + 60.0 + _most_s(robot, scenario, terms) + 2 * scenario.longest_s
        async with asyncio.timeout(most_s), AsyncExitStack() as stack:
            clients = [
                await stack.enter_async_context(AsyncClient(around.url, timeout_s=TIMEOUT_S))
                for _ in range(2)
            ]
            id = f"{robot.name}.{trial.cls}.{number}"
            live = LiveRobot(
                robot,
                scenario,
                record,
                terms.preset,
                id,
                (clients[0], clients[1]),
                around.folder / id,
                around.clock,
            )
            stack.push_async_callback(live.close)
            await _Play(live, terms, around, clients[0]).run()
    except Exception as error:  # noqa: BLE001  # whatever breaks a trial is told in its place; the others go on
        record.error = record.error or f"{type(error).__name__}: {error}"
    return record


def longer_s(robot: Robot, scenario: Scenario) -> float:
    """Return how much longer nothing must happen, in the field, until nothing more is to come."""
    if robot.world != "field":
        return 0.0
    again_s = LIVES_S + 2.0 if any(fault.kind in AGAIN for fault in scenario.faults) else 0.0
    reporting = scenario.reporting
    reports_s = 2 * reporting.late_s + reporting.lifetime_s if reporting != Reporting() else 0.0
    return max(again_s, 1.2 * scenario.longest_s, aspects_delay_s(robot.anatomy), reports_s)


def _most_s(robot: Robot, scenario: Scenario, terms: Terms) -> float:
    """Return how long a trial may take, from its first fault: in the field there is more to be waited for."""
    return terms.most_s + (60.0 + 5 * scenario.longest_s if robot.world == "field" else 0.0)


class _Play:
    def __init__(self, live: LiveRobot, terms: Terms, around: Bench, client: AsyncClient) -> None:
        self._live = live
        self._terms = terms
        self._around = around
        self._client = client
        self._chance = random.Random(f"times {live.record.trial}")
        self._stretch: Stretch | None = STRETCH_BY_NAME.get(live.record.trial.cls)
        self._expected = 0  # faults that have not begun yet

    async def run(self) -> None:
        live, client = self._live, self._client
        usual = live.robot.model == find_robot(live.record.trial.robot, self._terms.topics_hz).model
        model = live.robot.name if usual else live.id
        await self._around.model(client, model, live.robot.model)
        slow = live.scenario.slowness > 1.0
        settings = live.robot.settings(await live.open(), live.observed(), slow=slow)
        settings["model"] = model
        boots = self._stretch is not None and self._stretch.boots
        first_boots = self._stretch is None and (self._terms.boots or live.scenario.boots)
        if boots or first_boots:
            live.body.power_down()
        self._around.join(live)
        try:
            await client.put_robot(live.id, {**settings, "policy": "observe"} if first_boots else settings)
            for agent in live.agents:
                live.start_agent(agent)
            if first_boots:
                await self._starts()
            if boots:
                live.begin()
            else:  # that it starts is no part of the trial: until it has, it was only watched
                await self._healthy(settings if first_boots else None)
            async with self._asking():
                if self._stretch is not None:
                    await self._hold(self._stretch)
                else:
                    await self._break()
            live.record.end_s = live.at_s()
            await self._read_repairs()
            broken = [agent.broken for agent in live.agents if agent.broken]
            if broken:
                live.record.error = f"the bench's agent has ended: {broken[0]}"
        finally:
            self._around.leave(live)
            await self._forget()

    async def _healthy(self, settings: dict[str, Any] | None) -> None:
        """Wait until the service has heard every observer and finds the robot healthy; then configure it."""
        live = self._live
        deadline = self._around.clock() + READY_S + 2 * live.scenario.longest_s
        wanted = {str(literal) for literal in live.observed()}
        while True:
            obs = await self._client.observations(live.id)
            held = {entry["literal"] for entry in obs["observations"] if entry["fresh"]}
            diagnosis = await self._client.diagnosis(live.id)
            result = diagnosis["result"]
            healthy = result is not None and any(not each["bad"] for each in result["diagnoses"])
            heard = wanted <= held or live.scenario.reporting.lifetime_s < live.scenario.reporting.heartbeat_s
            if heard and healthy:
                break
            if self._around.clock() > deadline:
                raise NotHealthy(f"after {READY_S:g} s, missing {sorted(wanted - held)[:5]}")
            await asyncio.sleep(0.2)
        if settings is not None:
            await self._client.put_robot(live.id, settings, "*")
        await asyncio.sleep(self._chance.uniform(0.2, 1.2))  # anywhere in the observers' periods
        live.begin()

    async def _starts(self) -> None:
        """Let the agents start every process, once the service knows that none runs."""
        live, deadline = self._live, self._around.clock() + READY_S
        stopped = {f"not running({name})" for name in live.robot.anatomy.nodes}
        while self._around.clock() < deadline:
            obs = await self._client.observations(live.id)
            if stopped <= {entry["literal"] for entry in obs["observations"]}:
                return await boot(live, self._chance)
            await asyncio.sleep(LOOK_S)
        raise NotHealthy(f"after {READY_S:g} s, nobody has heard that nothing runs")

    async def _hold(self, stretch: Stretch) -> None:
        """Let the healthy robot be disturbed."""
        disturbing = asyncio.create_task(stretch.disturb(self._live, self._chance))
        try:
            await asyncio.sleep(stretch.seconds)
        finally:
            disturbing.cancel()
            await asyncio.gather(disturbing, return_exceptions=True)
        if disturbing.done() and not disturbing.cancelled() and (error := disturbing.exception()):
            raise OSError(f"the disturbance failed: {error!r}")

    @asynccontextmanager
    async def _asking(self) -> AsyncIterator[None]:
        """Ask now and then how the robot is, as a page does, where the world is the field."""
        asking = asyncio.create_task(self._ask()) if self._live.robot.world == "field" else None
        try:
            yield
        finally:
            if asking is not None:
                asking.cancel()
                await asyncio.gather(asking, return_exceptions=True)

    async def _ask(self) -> None:
        live = self._live
        while True:
            await asyncio.sleep(ASK_S)
            with contextlib.suppress(ClientError):
                asked_s = live.at_s()
                answer = await self._client.robot(live.id)
                if answer.value["state"] == "healthy":
                    live.record.called_healthy.append((asked_s, live.at_s()))

    async def _break(self) -> None:
        live, scenario = self._live, self._live.scenario
        disturbing = None
        if scenario.disturbed:
            disturb = STRETCH_BY_NAME[scenario.disturbed].disturb
            disturbing = asyncio.create_task(disturb(live, self._chance))
        try:
            await self._until_over(disturbing)
        finally:
            if disturbing is not None:
                disturbing.cancel()
                await asyncio.gather(disturbing, return_exceptions=True)

    async def _until_over(self, disturbing: asyncio.Task[None] | None) -> None:
        live, scenario = self._live, self._live.scenario
        most_s = _most_s(live.robot, scenario, self._terms)
        if scenario.blind is not None:
            live.disturb_observer()
            live.note(f"observer of {scenario.blind.topic}: {scenario.blind.how}")
            live.last_s = self._around.clock()
        waiting = [each for each in scenario.planted if each.follows_act]
        for each in scenario.planted:
            if not each.follows_act:
                self._plan(each)
        while True:
            await asyncio.sleep(LOOK_S)
            if waiting and live.record.acts:
                for each in waiting:
                    self._plan(each)
                waiting = []
            if disturbing is not None and disturbing.done():
                disturbing = None
                live.happened()  # what was kept from judging, or from acting, begins now
            over = disturbing is None and self._over(bool(waiting)) and await self._retried(most_s)
            if over or live.at_s() > most_s or live.record.error:
                return

    def _plan(self, planted: Planted) -> None:
        live = self._live

        def begin() -> None:
            self._expected -= 1
            live.plant(planted.fault)
            live.cut_off(live.scenario.cut_off, cut=bool(live.scenario.cut_off))

        self._expected += 1
        if planted.after_s:
            live.later(planted.after_s, begin)
        else:
            begin()
        at_s = planted.after_s
        for number, spell_s in enumerate(planted.spells_s):
            at_s += spell_s
            live.later(at_s, self._spell(planted, number))

    def _spell(self, planted: Planted, number: int) -> Callable[[], None]:
        live = self._live

        def pass_by() -> None:
            self._expected -= 1
            (live.plant if number % 2 else live.lift)(planted.fault)
            live.cut_off(live.scenario.cut_off, cut=bool(number % 2 and live.scenario.cut_off))

        def change() -> None:
            if not any(act.act.parameters == (planted.fault.component,) for act in live.record.acts):
                (live.plant if number % 2 else live.lift)(planted.fault)

        if planted.fault.kind in PASSING:
            self._expected += 1
            return pass_by
        return change

    async def _retried(self, most_s: float) -> bool:
        """Whether nothing is announced to be tried again, by when what is slow may be ready."""
        live = self._live
        if not live.scenario.longest_s or not live.record.repairs or not live.record.faults:
            return True
        repair = await self._client.repair(live.record.repairs[-1].id)
        left_s = (repair["retry_ns"] or 0) / 1e9 - time.time()
        if repair["state"] != "escalated" or left_s <= 0 or live.at_s() + left_s > most_s:
            return True
        await asyncio.sleep(min(left_s, ASK_S))
        return left_s <= ASK_S and await self._again(repair["id"])

    async def _again(self, repair: str) -> bool:
        """Give what is tried again a moment to begin; whether it has not."""
        for _ in range(round(AGAIN_S / LOOK_S)):
            await asyncio.sleep(LOOK_S)
            if self._live.record.repairs[-1].id != repair:
                return False
        return True

    def _over(self, waiting: bool) -> bool:
        """Whether nothing more is to come: nothing to happen by itself, no repair open, and long quiet."""
        live = self._live
        quiet_s = self._around.clock() - live.last_s
        if live.record.open_repairs or self._expected > 0:
            return False
        spells = [
            s for each in live.scenario.planted for s in each.spells_s if each.fault.kind not in PASSING
        ]
        if spells and not live.record.acts and live.at_s() < sum(spells):
            return False
        enough_s = self._terms.quiet_s + (5.0 if waiting else 0.0)
        if live.scenario.slowness > 1.0 or live.scenario.blind is not None:
            enough_s += 5.0  # what starts slowly, or runs out, takes its time
        enough_s += longer_s(live.robot, live.scenario)
        return quiet_s > enough_s

    async def _read_repairs(self) -> None:
        """Read each repair as a person would: what it says of itself, and whether that is what happened."""
        record = self._live.record
        for id in dict.fromkeys(seen.id for seen in record.repairs):
            repair = await self._client.repair(id)
            if repair["state"] in ENDED:
                record.contradictions += (f"{id}: {why}" for why in contradictions(repair))
            if self._terms.accounts:
                record.account += repair["account"]
            record.credited += self._live.credited(repair)

    async def _forget(self) -> None:
        """Take the robot away from the service, so that it does not care for what is no longer there."""
        live = self._live
        for agent in live.agents:
            await agent.stop()
        for repair in live.record.open_repairs:
            with contextlib.suppress(ClientError):
                await self._client.cancel(repair, "the trial is over")
        for _ in range(20):
            try:
                await self._client.delete_robot(live.id, "*")
                return
            except ClientError:  # the repair is still ending
                await asyncio.sleep(0.25)
