"""Executing a plan on a small robot that can misbehave: a lidar, its driver, and the topic scan."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace

import pytest

from robomend.model.cnf import HealthCnf, Rule
from robomend.repair.execution import execute
from robomend.repair.execution_values import (
    Ending,
    Execution,
    Setting,
    StepReport,
    StepState,
    Timing,
    Withheld,
)
from robomend.repair.plan import Outcome, Plan, Step
from robomend.repair.prediction import Prediction, Theory
from robomend_client.actions import FAILED, OK, REFUSED, TIMED_OUT, Action, ActionResult, Feedback
from robomend_client.literals import Atom, Literal, fails, holds

ON, RUNNING, SCAN = Atom("on", ("lidar",)), Atom("running", ("driver",)), Atom("ok", ("scan",))

CNF = HealthCnf(
    name="lidar robot",
    components=("lidar", "driver"),
    atoms=(ON, RUNNING, SCAN),
    clauses=((-1, 3), (-2, 4), (-1, -2, 5)),
    origins=(0, 1, 2),
    rules=(Rule("1", "scheme 1"), Rule("5", "scheme 5"), Rule("2", "scheme 2")),
    variables=5,
)

QUICK = Timing(action_timeout_s=0.5, effect_timeout_s=0.3, retries=1, backoff_s=0.01, hold_s=0.05)


def step(index: int, name: str, parameter: str, after: tuple[int, ...] = ()) -> Step:
    """One action of the repair domain, grounded for this robot."""
    thing = (parameter,)
    before, effects = {
        "power_up": (
            [Literal(Atom("off", thing))],
            [
                Literal(Atom("on", thing)),
                -Literal(Atom("off", thing)),
                holds("good", *thing),
                fails("bad", *thing),
                holds("bad", "driver"),
                fails("good", "driver"),
            ],
        ),
        "stop_node": (
            [holds("running", *thing)],
            [
                holds("stopped", *thing),
                fails("running", *thing),
                holds("bad", *thing),
                fails("good", *thing),
            ],
        ),
        "start_node": (
            [holds("stopped", *thing)],
            [
                holds("running", *thing),
                fails("stopped", *thing),
                holds("good", *thing),
                fails("bad", *thing),
            ],
        ),
    }[name]
    return Step(index, name, (parameter,), 1.0, after, tuple(before), tuple(effects))


POWER_LOST = Plan(
    outcome=Outcome.SOLVED,
    steps=(
        step(0, "power_up", "lidar"),
        step(1, "stop_node", "driver", (0,)),
        step(2, "start_node", "driver", (1,)),
    ),
    cost=3.0,
    planner="by hand",
    initial=frozenset(
        Atom(p, (c,))
        for p, c in [("off", "lidar"), ("bad", "lidar"), ("running", "driver"), ("good", "driver")]
    ),
    assumed=(),
    unreachable=(),
    excluded=(),
    elapsed_s=0.0,
)


@dataclass
class Robot:
    """A robot in memory: OBS on one side, its actions on the other. `behave` lets a test spoil an action."""

    obs: dict[Atom, bool] = field(default_factory=lambda: {ON: False, RUNNING: True, SCAN: False})
    revision: int = 0
    sent: list[str] = field(default_factory=list)
    journal: list[str] = field(default_factory=list)
    behave: Callable[[Robot, Action], Awaitable[ActionResult | None]] | None = None
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def see(self, atom: Atom, value: bool | None) -> None:
        self.obs.pop(atom, None)
        if value is not None:
            self.obs[atom] = value
        self.revision += 1
        self.news.set()
        self.news = asyncio.Event()

    def value(self, atom: Atom) -> bool | None:
        return self.obs.get(atom)

    async def changed(self, revision: int, timeout_s: float) -> int:
        if self.revision == revision:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self.news.wait(), timeout_s)
        return self.revision

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        self.sent.append(str(action))
        if self.behave is not None:
            result = await self.behave(self, action)
            if result is not None:
                return result
        await self.do(action)
        return ActionResult(OK)

    async def do(self, action: Action) -> None:
        match action.name:
            case "power_up":
                self.see(ON, True)
            case "stop_node":
                self.see(RUNNING, False)
            case "start_node":
                self.see(RUNNING, True)
                if self.obs.get(ON):
                    asyncio.get_running_loop().call_later(0.02, self.see, SCAN, True)

    async def intend(self, action: Action, report: StepReport) -> None:
        self.journal.append(f"intend {action.id} {action}")

    async def settle(self, action: Action, result: ActionResult, report: StepReport) -> None:
        self.journal.append(f"settle {action.id} {result.code}")


async def permit_all(step: Step) -> str | None:
    return None


def setting(robot: Robot) -> Setting:
    plan = POWER_LOST
    return Setting(
        repair="r-1",
        first_step=0,
        sight=robot,
        prediction=Prediction(Theory(CNF), CNF.components, plan.initial),
        executors=dict.fromkeys(("power_up", "stop_node", "start_node"), robot),
        journal=robot,
        permit=permit_all,
        halt=asyncio.Event(),
        observed=frozenset({ON, RUNNING, SCAN}),
        default_timing=QUICK,
    )


async def run(robot: Robot, plan: Plan = POWER_LOST) -> Execution:
    return await execute(plan, setting(robot))


pytestmark = pytest.mark.anyio


async def test_each_action_is_journaled_sent_and_its_effect_seen() -> None:
    robot = Robot()
    done = await run(robot)
    assert done.ending is Ending.DONE
    assert robot.sent == ["power_up(lidar)", "stop_node(driver)", "start_node(driver)"]
    assert robot.journal == [
        "intend r-1:0 power_up(lidar)",
        "settle r-1:0 0",
        "intend r-1:1 stop_node(driver)",
        "settle r-1:1 0",
        "intend r-1:2 start_node(driver)",
        "settle r-1:2 0",
    ]
    assert [report.seen for report in done.steps] == [
        (Literal(ON),),
        (-Literal(RUNNING),),
        (Literal(SCAN), Literal(RUNNING)),
    ]
    assert done.effect_seen


async def test_a_mute_driver_after_the_power_came_back_is_expected_not_news() -> None:
    robot = Robot()

    async def slow_to_stop(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "stop_node":
            await asyncio.sleep(0.2)  # on(lidar), running(driver) and not ok(scan), for longer than hold_s
        return None

    robot.behave = slow_to_stop
    assert (await run(robot)).ending is Ending.DONE


async def test_an_effect_that_is_already_there_is_not_brought_about_again() -> None:
    robot = Robot()
    robot.see(ON, True)
    done = await run(robot)
    assert done.ending is Ending.DONE
    assert done.steps[0].state is StepState.ALREADY
    assert robot.sent == ["stop_node(driver)", "start_node(driver)"]


async def test_a_stuck_relay_is_told_by_the_missing_effect() -> None:
    robot = Robot()

    async def stuck(robot: Robot, action: Action) -> ActionResult | None:
        return ActionResult(OK) if action.name == "power_up" else None

    robot.behave = stuck
    done = await run(robot)
    assert done.ending is Ending.EFFECT_MISSING
    assert done.mismatch == Literal(ON)
    assert done.reason == "power_up(lidar) answered 'done', but on(lidar) was not seen within 0.3 s"
    assert robot.sent == ["power_up(lidar)"]
    assert not done.effect_seen


async def test_a_late_effect_is_waited_for() -> None:
    robot = Robot()

    async def late(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "power_up":
            asyncio.get_running_loop().call_later(0.15, robot.see, ON, True)
            return ActionResult(OK)
        return None

    robot.behave = late
    assert (await run(robot)).ending is Ending.DONE


async def test_an_effect_that_flips_back_ends_the_plan() -> None:
    robot = Robot()

    async def flips(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "stop_node":
            robot.see(ON, False)
            await asyncio.sleep(0.3)
        return None

    robot.behave = flips
    done = await run(robot)
    assert done.ending is Ending.MISMATCH
    assert done.mismatch == Literal(ON)
    assert robot.sent == ["power_up(lidar)", "stop_node(driver)"]


async def test_a_flutter_shorter_than_the_hold_time_is_no_mismatch() -> None:
    robot = Robot()

    async def flutter(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "stop_node":
            robot.see(ON, False)
            await asyncio.sleep(0.01)
            robot.see(ON, True)
            await asyncio.sleep(0.15)
        return None

    robot.behave = flutter
    assert (await run(robot)).ending is Ending.DONE


async def test_a_failed_action_is_tried_again_under_a_new_id() -> None:
    robot = Robot()

    async def fails_once(robot: Robot, action: Action) -> ActionResult | None:
        return ActionResult(FAILED, "busy") if action.id == "r-1:1" else None

    robot.behave = fails_once
    assert (await run(robot)).ending is Ending.DONE
    assert "intend r-1:1.1 stop_node(driver)" in robot.journal


async def test_an_action_that_keeps_failing_ends_the_plan_with_its_message() -> None:
    robot = Robot()

    async def broken(robot: Robot, action: Action) -> ActionResult | None:
        return ActionResult(7, "no such node") if action.name == "stop_node" else None

    robot.behave = broken
    done = await run(robot)
    assert done.ending is Ending.ACTION_FAILED
    assert done.reason == "stop_node(driver) ended with result 7: no such node"
    assert robot.sent.count("stop_node(driver)") == 2


async def test_an_action_without_an_answer_counts_as_done_when_its_effect_shows() -> None:
    robot = Robot()

    async def acts_but_never_answers(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "power_up":
            await robot.do(action)
            return ActionResult(TIMED_OUT, "the acknowledge was lost")
        return None

    robot.behave = acts_but_never_answers
    assert (await run(robot)).ending is Ending.DONE
    assert robot.sent.count("power_up(lidar)") == 1


async def test_an_action_that_must_not_be_repeated_asks_when_its_outcome_is_unknown() -> None:
    robot = Robot()

    async def silent(robot: Robot, action: Action) -> ActionResult | None:
        return ActionResult(TIMED_OUT)

    robot.behave = silent
    done = await execute(POWER_LOST, replace(setting(robot), not_idempotent={"power_up"}))
    assert done.ending is Ending.UNKNOWN_OUTCOME
    assert robot.sent == ["power_up(lidar)"]


async def test_an_unknown_outcome_is_told_even_if_another_step_failed_before_it() -> None:
    robot = Robot()
    both = replace(POWER_LOST, steps=(step(0, "power_up", "lidar"), step(1, "stop_node", "driver")))

    async def one_fails_one_is_silent(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "power_up":
            await asyncio.sleep(0.1)
            return ActionResult(TIMED_OUT)
        return ActionResult(REFUSED, "not now")

    robot.behave = one_fails_one_is_silent
    done = await execute(both, replace(setting(robot), not_idempotent={"power_up"}))
    assert done.ending is Ending.UNKNOWN_OUTCOME


async def test_a_hanging_executor_is_cut_off() -> None:
    robot = Robot()

    async def hangs(robot: Robot, action: Action) -> ActionResult | None:
        await asyncio.sleep(60)
        return None

    robot.behave = hangs
    quick = replace(QUICK, action_timeout_s=0.05, retries=0)
    done = await execute(POWER_LOST, replace(setting(robot), default_timing=quick))
    assert done.ending is Ending.ACTION_FAILED
    assert done.reason == "power_up(lidar) was sent, and its outcome is unknown: no answer in 0.05 s"


async def test_stopping_sends_nothing_more_and_cuts_off_what_runs() -> None:
    robot = Robot()
    here = setting(robot)

    async def stop_in_the_middle(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "stop_node":
            here.halt.set()
            await asyncio.sleep(60)
        return None

    robot.behave = stop_in_the_middle
    async with asyncio.timeout(10.0):  # a second is what is promised; the machine may be busy
        done = await execute(POWER_LOST, here)
    assert done.ending is Ending.HALTED
    assert robot.sent == ["power_up(lidar)", "stop_node(driver)"]
    assert robot.journal[-1] == "settle r-1:1 5"


async def test_a_stop_that_comes_while_the_intent_is_written_sends_nothing() -> None:
    robot = Robot()
    here = setting(robot)
    intend = robot.intend

    async def halting(action: Action, report: StepReport) -> None:
        await intend(action, report)
        here.halt.set()

    robot.intend = halting  # type: ignore[method-assign]  # a test double of a test double
    done = await execute(POWER_LOST, here)
    assert done.ending is Ending.HALTED
    assert robot.sent == []


async def test_nothing_acts_on_an_observation_that_went_stale() -> None:
    robot = Robot()

    async def agent_gone(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "power_up":
            robot.see(RUNNING, None)
        return None

    robot.behave = agent_gone
    done = await run(robot)
    assert done.ending is Ending.STALE
    assert done.mismatch == Literal(RUNNING)
    assert robot.sent == ["power_up(lidar)"]


async def test_a_refused_step_is_not_sent() -> None:
    robot = Robot()

    async def refuse(step: Step) -> str | None:
        return "the policy says no" if step.name == "stop_node" else None

    done = await execute(POWER_LOST, replace(setting(robot), permit=refuse))
    assert done.ending is Ending.NOT_PERMITTED
    assert done.reason == "stop_node(driver): the policy says no"
    assert robot.sent == ["power_up(lidar)"]


async def test_steps_that_are_not_ordered_run_side_by_side() -> None:
    robot = Robot(obs={})
    both = asyncio.Barrier(2)

    async def meet(robot: Robot, action: Action) -> ActionResult | None:
        async with asyncio.timeout(10.0):
            await both.wait()
        return ActionResult(OK)

    robot.behave = meet
    plan = replace(
        POWER_LOST,
        steps=(step(0, "power_up", "lidar"), step(1, "power_up", "camera")),
        initial=frozenset({Atom("off", ("lidar",)), Atom("off", ("camera",))}),
    )
    here = replace(setting(robot), observed=frozenset(), prediction=Prediction(Theory(CNF), (), plan.initial))
    done = await execute(plan, here)
    assert done.ending is Ending.DONE
    assert sorted(robot.sent) == ["power_up(camera)", "power_up(lidar)"]


async def test_a_journal_that_withholds_an_intent_ends_the_plan_unsent() -> None:
    robot = Robot()

    async def withhold(action: Action, report: StepReport) -> None:
        raise Withheld("global stop: people on the floor")

    robot.intend = withhold  # type: ignore[method-assign]  # a test double of a test double
    done = await run(robot)
    assert (done.ending, done.reason) == (Ending.HALTED, "global stop: people on the floor")
    assert robot.sent == []


async def test_an_action_cut_off_by_the_end_of_the_service_keeps_its_intent_open() -> None:
    robot = Robot()
    begun = asyncio.Event()

    async def hangs(robot: Robot, action: Action) -> ActionResult | None:
        begun.set()
        await asyncio.sleep(60)
        return None

    robot.behave = hangs
    task = asyncio.create_task(run(robot))
    await begun.wait()
    task.cancel()
    await asyncio.wait({task})
    assert robot.journal == ["intend r-1:0 power_up(lidar)"]


async def test_an_executor_that_breaks_counts_as_no_answer() -> None:
    robot = Robot()

    async def broken(robot: Robot, action: Action) -> ActionResult | None:
        raise ZeroDivisionError("a driver's mistake")

    robot.behave = broken
    done = await run(robot)
    assert done.ending is Ending.ACTION_FAILED
    assert done.reason == (
        "power_up(lidar) was sent, and its outcome is unknown: "
        "the executor failed: ZeroDivisionError: a driver's mistake"
    )
    assert "settle r-1:0 3" in robot.journal
