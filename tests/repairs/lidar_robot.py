"""A small robot that can misbehave, for the tests of execution: a lidar, its driver, and the topic scan."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Collection
from dataclasses import dataclass, field
from math import inf

from robomend.model.cnf import HealthCnf, Rule
from robomend.planning.plan import Outcome, Plan, Step
from robomend.planning.prediction import Prediction, Theory
from robomend.repairs.execution import execute
from robomend.repairs.execution_values import (
    Execution,
    Setting,
    StepReport,
    Timing,
)
from robomend_client.actions import OK, Action, ActionResult, Feedback
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
    known_s: float = inf  # how long a start may take more, by earlier ones
    due_in_s: float = -inf  # how long what is awaited may take at least, by its model or by earlier ones
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

    def reported(self, atom: Atom) -> bool:
        return atom in self.obs

    def settling_s(self, atom: Atom) -> float:
        return 0.0

    def turns_s(self, atom: Atom, acted_ns: int) -> float:
        return 0.0

    def may_take_s(self, missing: Collection[Literal], sent_ns: int, answered_ns: int) -> float:
        return self.known_s

    def due_s(self, missing: Collection[Literal], usual_s: float) -> float:
        return self.due_in_s

    def rose_ns(self, atom: Atom) -> int | None:
        return None

    def fell_ns(self, atom: Atom) -> int | None:
        return None

    def denied_s(self, missing: Collection[Literal], sent_ns: int, answered_ns: int) -> float:
        return inf

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
        interlocked=lambda: None,
        again=lambda step: None,
        observed=frozenset({ON, RUNNING, SCAN}),
        default_timing=QUICK,
    )


async def run(robot: Robot, plan: Plan = POWER_LOST) -> Execution:
    return await execute(plan, setting(robot))
