"""One repair of one robot: what the loop (robomend.cycle) asks for, answered by the service around it.

Everything that must outlive a crash goes through its record into the store before the loop goes on. A repair
itself keeps nothing: after a crash a new one is made from the store and fresh OBS.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from robomend.cycle import stands_no_more
from robomend.diagnosis.result import DiagnosisResult
from robomend.errors import InputError, Overloaded, RobomendError
from robomend.planning.choice import Choice, attempt
from robomend.planning.plan import Plan, Step
from robomend.planning.policy import Mode, Policy
from robomend.planning.prediction import Prediction, theory_of
from robomend.planning.quarantine import quarantined
from robomend.repairs.choosing import Chooser, record_of
from robomend.repairs.execution_values import Ending, Execution, Setting, StepReport, StepState, Timing
from robomend.repairs.hearing import Hearing, LiveSight
from robomend.repairs.record import RepairRecord
from robomend.repairs.signals import Signals
from robomend.robots.robot import Robot
from robomend.robots.robots import Robots
from robomend.store import Store
from robomend.store.records import Quarantine
from robomend_client.actions import Action, ActionResult, Executor
from robomend_client.literals import Atom, Literal

LOOK_S = 0.25
"""How often a wait for OBS looks at the clock as well: what grows stale wakes nobody."""

BUSY_S = 60.0
"""How long a repair waits for a planner when every one is busy."""


class Silent(InputError):
    """Observers of the robot's `observed` list are silent: an automatic repair would be blind."""

    code = "not-observed"


class Overtaken(InputError):
    """While a plan waited for a person, the diagnosis changed."""

    code = "overtaken"


class LiveRepair:
    """See the module; implements robomend.cycle.Repair."""

    def __init__(
        self,
        *,
        store: Store,
        robots: Robots,
        chooser: Chooser,
        state: Robot,
        record: RepairRecord,
        executors: Mapping[str, Executor],
        signals: Signals,
        heard_since: int | None,
    ) -> None:
        """`heard_since`: see Hearing."""
        self._robots = robots
        self._chooser = chooser
        self._state = state
        self._record = record
        self._executors = executors
        self._signals = signals
        self._hearing = Hearing(store, robots, state, heard_since)
        # A crash does not give a repair new rounds, but it may always finish.
        self.rounds = max(1, self._policy.rounds - len(record.data.get("rounds", ())))
        self._sight = LiveSight(robots, state)
        self._components = frozenset(state.system.cnf.components)
        self._settled = 0  # the revision of OBS when the last action had answered
        self._first = 0  # number of the present round's first step within the repair
        self._attempts: Counter[str] = Counter()  # actions by component in the last hour

    @property
    def _policy(self) -> Policy:
        """The policy as it is configured now: a change counts from the next action on."""
        return self._chooser.policy(self._state)

    # --- diagnose

    async def diagnose(self) -> DiagnosisResult:
        """Return the diagnosis of OBS now, after every configured observer was heard."""
        await self._hear_all()
        wanted = self._record.data.get("wanted")
        result = await self._newest()
        if wanted and not result.healthy and not self._record.data.get("rounds"):
            named = tuple(d for d in result.diagnoses if set(d.bad) == set(wanted))
            if named:
                return DiagnosisResult(
                    result.components, named, result.complete, result.stopped_by, result.conflicts, 0.0
                )
        return result

    async def _hear_all(self) -> None:
        """Wait until OBS holds each literal that the observers will report, with either sign.

        A person who asked for the repair is not kept waiting; what is unknown then is assumed, and shown.
        """
        asked = bool(self._record.data.get("asked")) and not self._hearing.anew
        deadline = time.monotonic() + self._state.config.observed_timeout_s
        told: list[str] = []
        while missing := await self._hearing.unheard():
            names = [str(atom) for atom in missing]
            if asked:
                return
            if time.monotonic() >= deadline:
                raise Silent(
                    f"nobody reported {', '.join(names)} within {self._state.config.observed_timeout_s:g} s: "
                    "start the observers, or take them off the robot's `observed` list"
                )
            if names != told:
                told = names
                await self._record.update("waiting", reason="for observers", waiting_for=names)
            await self._signals.unless_halted(self._sight.changed(self._sight.revision, LOOK_S))
        self._hearing.anew = False
        if told:
            await self._record.update("planning", waiting_for=[])

    async def _newest(self) -> DiagnosisResult:
        """Return the diagnosis of OBS as it is now; the fault, if there is none, is raised."""
        state = self._state
        while True:
            if state.stale:
                await self._robots.robot(state.id)
            current, revision = state.current, state.revision
            if current is not None and current.answer is not None and current.revision >= revision:
                if current.answer.result is not None:
                    return current.answer.result
                assert current.answer.fault is not None
                raise current.answer.fault
            count = state.diagnosed.value
            if state.task is None:
                self._robots.diagnosing.wake(state)
            await self._signals.unless_halted(state.diagnosed.beyond(count, LOOK_S))

    # --- choose

    async def choose(self, result: DiagnosisResult) -> Choice:
        """Plan for the leading diagnoses; wait for a probe's outcome where looking first is cheaper."""
        found = await self._planned(result, looks=True)
        if found.probe is not None:
            atom = found.probe.atom
            await self._record.update(
                "waiting", reason=found.reason, waiting_for=[str(atom)], probe={"atom": str(atom)}
            )
            deadline = time.monotonic() + self._state.config.observed_timeout_s
            while self._state.value(atom) is None and time.monotonic() < deadline:
                await self._signals.unless_halted(self._sight.changed(self._sight.revision, LOOK_S))
            result = await self._newest()
            found = await self._planned(result, looks=False)
        if found.plan is not None and found.diagnosis is not None:
            bad = found.diagnosis.bad
            self._first = await self._record.begin_round(
                found.plan,
                bad=bad,
                good=result.good(found.diagnosis),
                why=found.reason,
                conflicts=[c.text for c in result.conflicts if set(c.components) & set(bad)],
            )
        return found

    async def _planned(self, result: DiagnosisResult, *, looks: bool) -> Choice:
        """Choose; wait for a turn where the planners are busy with other robots."""
        deadline, pause_s = time.monotonic() + BUSY_S, 0.2
        while True:
            try:
                choosing = self._chooser.choose(self._state, result, looks=looks)
                return await self._signals.unless_halted(choosing)
            except Overloaded:
                if time.monotonic() >= deadline:
                    raise
            await self._signals.unless_halted(asyncio.sleep(pause_s))
            pause_s = min(2 * pause_s, 5.0)

    # --- approve

    async def approved(self, choice: Choice) -> bool:
        """Ask the policy, and a person where it says so; a yes counts while the plan's diagnosis stands."""
        assert choice.plan is not None
        assert choice.diagnosis is not None
        steps = choice.plan.steps
        self._attempts = Counter(await self._chooser.attempts(self._state.id))
        refusal = self._policy.plan_refusal(steps, self._attempts, self._components)
        if refusal is not None:
            raise NotPermitted(refusal)
        if self._policy.mode_for(steps) is not Mode.APPROVE or self._covered(steps):
            await self._record.update("running")
            return not self._signals.halt.is_set()
        self._signals.ask()  # before the question can be seen, or a quick yes would be lost
        await self._record.update("awaiting-approval", reason=choice.reason)
        while not await self._signals.decided(LOOK_S):
            if self._signals.halt.is_set():
                return False
            self._check_stands(choice, await self._newest())
        self._check_stands(choice, await self._newest())
        by = self._signals.by
        await self._record.update(
            "running",
            by=by,
            reason=f"approved by {by}",
            answers=self._signals.answers(),
            approved=approval(by, map(str, steps)),
        )
        return not self._signals.halt.is_set()

    def _covered(self, steps: Sequence[Step]) -> bool:
        """Whether a yes that was given before a crash covers the plan that is left."""
        given = self._record.data.get("approved")
        return given is not None and Counter(map(str, steps)) <= Counter(given["steps"])

    def _check_stands(self, choice: Choice, result: DiagnosisResult) -> None:
        assert choice.diagnosis is not None
        if not any(set(d.bad) >= set(choice.diagnosis.bad) for d in result.diagnoses):
            now = "the robot is healthy again" if result.healthy else "the diagnosis is another one now"
            raise Overtaken(f"{now}: the plan no longer applies")

    # --- act

    def setting(self, plan: Plan) -> Setting:
        """Return what the execution of this plan needs."""
        _, system, _ = self._state.question()
        once = self._chooser.not_idempotent(self._state)

        async def permit(step: Step) -> str | None:
            return self._policy.refusal(step, self._attempts, self._components)

        async def report(report: StepReport) -> None:
            await self._record.report(report, self._first)

        return Setting(
            repair=self._record.id,
            first_step=self._first,
            sight=self._sight,
            prediction=Prediction(theory_of(system.cnf), system.cnf.components, plan.initial),
            executors=self._executors,
            journal=self,
            permit=permit,
            halt=self._signals.halt,
            observed=self._hearing.observed,
            timing=_timings(self._state.config.actions, once),
            not_idempotent=once,
            report=report,
        )

    async def intend(self, action: Action, report: StepReport) -> None:
        """Write an intent (see Journal in execution_values), and count it for the limit per hour."""
        await self._record.intend(action, report)
        self._attempts.update(self._components.intersection(action.parameters))

    async def settle(self, action: Action, result: ActionResult, report: StepReport) -> None:
        """Write an outcome (robomend.repairs.execution_values.Journal)."""
        self._settled = self._sight.revision
        await self._record.settle(action, result, report)

    # --- look, remember

    async def look(self, choice: Choice, execution: Execution) -> DiagnosisResult:
        """Return the diagnosis of what came after: at once when it is clear, else when OBS had its time."""
        assert choice.diagnosis is not None
        if execution.ending is Ending.EFFECT_MISSING:
            await self._hear_the_missing(execution)
        done = execution.ending is Ending.DONE
        timing = Timing()
        deadline = time.monotonic() + (timing.effect_timeout_s if done else timing.hold_s)
        while True:
            revision = self._sight.revision
            result = await self._newest()
            helped = stands_no_more(choice.diagnosis.bad, result)
            if result.healthy and await self._hearing.unheard():
                # Nothing is known to be wrong because nothing is known: an observer fell silent meanwhile.
                await self._hear_all()
                return await self._newest()
            if result.healthy or (done and helped) or time.monotonic() >= deadline:
                return result
            await self._signals.unless_halted(self._sight.changed(revision, LOOK_S))

    async def _hear_the_missing(self, execution: Execution) -> None:
        """An effect that nobody could tell us of says nothing of the robot: Silent, unless they speak."""
        missing = [literal.atom for report in execution.steps for literal in report.missing]
        deadline = time.monotonic() + self._state.config.observed_timeout_s
        while silent := await self._hearing.silent_since(missing, self._settled):
            if time.monotonic() >= deadline:
                why = (
                    f"{execution.reason}, and nobody reported {', '.join(map(str, silent))} "
                    "since: look whether the observers still work"
                )
                await self._record.end_round(str(Ending.STALE), why, helped=False)
                raise Silent(why)
            await self._signals.unless_halted(self._sight.changed(self._sight.revision, LOOK_S))

    async def remember(self, choice: Choice, execution: Execution, *, helped: bool) -> None:
        """Keep the attempt; components whose repairs keep failing go into quarantine."""
        assert choice.plan is not None
        assert choice.diagnosis is not None
        now = time.time_ns()
        finished = {StepState.DONE, StepState.ALREADY}
        tried = attempt(
            choice.diagnosis,
            choice.plan,
            done=[report.step.index for report in execution.steps if report.state in finished or report.seen],
            time_ns=now,
            effect_seen=execution.effect_seen,
            helped=helped,
        )
        record = record_of(
            tried,
            self._state.id,
            self._record.id,
            {
                "ending": str(execution.ending),
                "reason": execution.reason,
                "direct": direct(execution.steps, choice.diagnosis.bad),
            },
        )
        memory = await self._chooser.remembered(self._state.id)
        patience = self._chooser.patience
        # Whoever allows many actions an hour means to mend what breaks often.
        relapses = max(patience.attempts, self._state.config.limits.attempts_per_hour // 2)
        left_alone = quarantined(
            [*memory.tried, tried], now_ns=now, patience=replace(patience, relapses=relapses)
        )
        await self._record.end_round(
            str(execution.ending),
            execution.reason,
            helped=helped,
            tried=record,
            quarantined=[
                Quarantine(
                    robot=self._state.id,
                    component=name,
                    reason=f"{entry.reason}; last: {execution.reason}" if execution.reason else entry.reason,
                    failures=entry.failures,
                    since_ns=now,
                    until_ns=entry.until_ns,
                )
                for name, entry in left_alone.items()
                if name not in memory.quarantined
            ],
        )


def approval(by: str, steps: Iterable[str]) -> dict[str, object]:
    """Return the record of a yes: who said it, and to which actions."""
    return {"by": by, "steps": list(steps)}


def direct(reports: Iterable[StepReport], bad: Collection[str]) -> list[str]:
    """Return the actions that were done and should have made a component of the diagnosis good.

    Where they did not help, another way is planned before the same is done again.
    """
    cures = {Literal(Atom("good", (name,))) for name in bad}
    return [
        str(report.step)
        for report in reports
        if report.result is not None and report.result.ok and cures & set(report.step.effects)
    ]


class NotPermitted(RobomendError):
    """A step of the plan that the policy refuses: a person must change the policy, or do it."""

    code = "not-permitted"


def _timings(configured: Mapping[str, Mapping[str, object]], once: Collection[str]) -> dict[str, Timing]:
    """Return action name -> its bounds; what must not be repeated is retried only if that is configured."""
    careful = {name: {"retries": 0} for name in once}
    return {
        name: _timing({**careful.get(name, {}), **_given(configured.get(name, {}))})
        for name in {*configured, *once}
    }


def _given(value: Mapping[str, object]) -> dict[str, object]:
    return {key: one for key, one in value.items() if one is not None}


def _timing(value: Mapping[str, object]) -> Timing:
    names = {"timeout_s": "action_timeout_s", "effect_timeout_s": "effect_timeout_s", "retries": "retries"}
    given = {name: value[key] for key, name in names.items() if key in value}
    return Timing(**given)  # type: ignore[arg-type]  # checked by the wire model
