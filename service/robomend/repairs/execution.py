"""Carry out a plan: check, send, and look whether it worked, step by step.

    predecessors done ──► permitted? ──► preconditions hold in OBS? ──► effect already there? ── yes ──► done
                                                                            │ no
        done ◄── OBS shows the effect ◄── await it ◄── result 0 ◄── send ◄── journal the intent

Steps that the plan does not order run side by side. While they run, a watch compares OBS with the state
that the plan predicts; a contradiction that lasts is a mismatch. Nothing here repairs a mismatch: execution
ends, says which literal it saw, and the loop diagnoses and plans again. A plan is never trusted beyond what
was seen.

Awaited are the literals that a step makes expected (robomend.planning.prediction) and that somebody observes:
on/off, running/stopped, and ok(t) once all that t rests on is predicted good.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import TypeVar

from robomend.planning.plan import Plan, Step
from robomend.planning.prediction import OBSERVED_FACTS, observable
from robomend.repairs.execution_values import (
    MAY_HAVE_ACTED,
    Ending,
    Execution,
    Setting,
    StepReport,
    Timing,
    Withheld,
    failure,
)
from robomend.repairs.states import STEP, STEP_ENDS, StepTrigger
from robomend.transitions import after
from robomend_client.actions import (
    CANCELLED,
    FAILED,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
)
from robomend_client.literals import Literal

T = TypeVar("T")


async def execute(plan: Plan, setting: Setting) -> Execution:
    """Carry out the plan and return what happened; never raises for what the world does.

    When `setting.halt` is set no further action is sent (at most 0.1 s), and running ones are cancelled.
    """
    return await _Run(plan, setting).run()


class _Stop(Exception):
    """Ends the execution from within a step."""

    def __init__(self, ending: Ending, reason: str, mismatch: Literal | None = None) -> None:
        super().__init__(ending, reason)
        self.ending = ending
        self.reason = reason
        self.mismatch = mismatch


class _Run:
    """The state of one execution. Lives in one event loop; steps are tasks."""

    def __init__(self, plan: Plan, setting: Setting) -> None:
        self._plan = plan
        self._setting = setting
        self._reports = [StepReport(step) for step in plan.steps]
        self._done: set[int] = set()
        self._agreed: set[Literal] = set()  # expected literals that OBS has shown
        self._tasks: dict[asyncio.Task[None], int] = {}

    async def run(self) -> Execution:
        stop: _Stop | None = None
        halted = asyncio.create_task(self._halted())
        watch = asyncio.create_task(self._watch())
        try:
            while stop is None and len(self._done) < len(self._plan.steps):
                self._start_ready()
                ended, _ = await asyncio.wait(
                    {halted, watch, *self._tasks}, return_when=asyncio.FIRST_COMPLETED
                )
                stop = self._collect(ended, halted, watch)
            if stop is not None and stop.ending is not Ending.HALTED:
                stop = await self._let_running_steps_end(halted) or stop
        finally:
            await _cancel({halted, watch, *self._tasks})
        if stop is None:
            return Execution(Ending.DONE, "every effect was seen", tuple(self._reports))
        return Execution(stop.ending, stop.reason, tuple(self._reports), stop.mismatch)

    async def _halted(self) -> None:
        await self._setting.halt.wait()

    def _start_ready(self) -> None:
        started = self._done | set(self._tasks.values())
        for step in self._plan.steps:
            if step.index not in started and self._done.issuperset(step.after):
                self._tasks[asyncio.create_task(self._step(step), name=str(step))] = step.index

    def _collect(
        self, ended: set[asyncio.Task[None]], halted: asyncio.Task[None], watch: asyncio.Task[None]
    ) -> _Stop | None:
        if halted in ended:
            return _Stop(Ending.HALTED, "stopped before the plan was done")
        for task in ended:
            index = self._tasks.pop(task, None)
            try:
                task.result()
            except _Stop as stop:
                return stop
            if index is not None:
                self._done.add(index)
        assert watch not in ended or watch.exception() is not None
        return None

    async def _let_running_steps_end(self, halted: asyncio.Task[None]) -> _Stop | None:
        """Return the stop of a step that a person must look at, whatever else ended the plan before it."""
        # Their actions are on the way and every wait in them is bounded; cutting them off would leave
        # outcomes unknown.
        doubt: _Stop | None = None
        while self._tasks and not halted.done():
            ended, _ = await asyncio.wait({halted, *self._tasks}, return_when=asyncio.FIRST_COMPLETED)
            for task in ended - {halted}:
                del self._tasks[task]
                stop = task.exception()
                if isinstance(stop, _Stop) and stop.ending is Ending.UNKNOWN_OUTCOME:
                    doubt = stop
        return doubt

    # --- one step ---------------------------------------------------------------------------------

    async def _step(self, step: Step) -> None:
        timing = self._setting.timing_of(step)
        try:
            await self._check_permitted(step)
            await self._check_preconditions(step, timing)
            if self._visible(step):
                self._setting.prediction.begin(step)
                self._setting.prediction.finish(step)
                await self._note(step, StepTrigger.EFFECT_THERE, reason="its effect was already there")
                return
            wanted = await self._act(step, timing)
            await self._await_effect(step, wanted, timing.effect_timeout_s)
        except _Stop as stop:
            await self._note(step, StepTrigger.WENT_WRONG, reason=stop.reason)
            raise

    async def _check_permitted(self, step: Step) -> None:
        refusal = await self._setting.permit(step)
        if refusal is not None:
            raise _Stop(Ending.NOT_PERMITTED, f"{step}: {refusal}")
        if step.name not in self._setting.executors:
            raise _Stop(Ending.NOT_PERMITTED, f"{step}: no executor is configured for {step.name!r}")

    async def _check_preconditions(self, step: Step, timing: Timing) -> None:
        """One that OBS contradicts, or that its observer no longer reports, gets a moment to clear up."""
        conditions = [observable(p) for p in step.preconditions]
        conditions = [p for p in conditions if p.atom.predicate not in {"good", "bad"}]

        def wrong() -> Literal | None:
            for literal in conditions:
                value = self._setting.sight.value(literal.atom)
                if value is None and literal.atom in self._setting.observed:
                    return literal
                if value is not None and value != literal.positive:
                    return literal
            return None

        literal = await self._until_none(
            wrong, timing.effect_timeout_s if self._stale(conditions) else timing.hold_s
        )
        if literal is None or self._visible(step):
            return
        if self._setting.sight.value(literal.atom) is None:
            raise _Stop(
                Ending.STALE, f"{step}: {literal} is no longer reported; nothing acts on old news", literal
            )
        raise _Stop(Ending.MISMATCH, f"{step}: expected {literal} before it, but saw {-literal}", literal)

    def _stale(self, conditions: list[Literal]) -> bool:
        return any(
            p.atom in self._setting.observed and self._setting.sight.value(p.atom) is None for p in conditions
        )

    def _visible(self, step: Step) -> bool:
        """Whether OBS already shows each on/off and running/stopped that the step brings about."""
        facts = {
            observable(effect)
            for effect in step.effects
            if effect.positive and observable(effect).atom.predicate in OBSERVED_FACTS
        }
        return bool(facts) and all(self._setting.sight.value(f.atom) == f.positive for f in facts)

    async def _act(self, step: Step, timing: Timing) -> frozenset[Literal]:
        """Send the action, again after a failure if it may be; return the literals that it makes expected."""
        prediction = self._setting.prediction
        prediction.begin(step)
        result = ActionResult(FAILED, "not sent")
        for attempt in range(timing.retries + 1):
            if attempt:
                await asyncio.sleep(timing.backoff_s * 2 ** (attempt - 1))
                await self._check_permitted(step)
                if self._visible(step):
                    break
            result = await self._send(step, attempt, timing)
            if result.ok or result.code == REFUSED:
                break
            if self._in_doubt(step, result):
                raise _Stop(Ending.UNKNOWN_OUTCOME, f"{failure(step, result)}; it must not be sent twice")
        if not result.ok and not await self._shows_anyway(step, result, timing):
            raise _Stop(Ending.ACTION_FAILED, failure(step, result))
        # Across `finish` alone: what other steps brought about meanwhile is theirs to await.
        before = prediction.expected()
        prediction.finish(step)
        return prediction.expected() - before

    async def _send(self, step: Step, attempt: int, timing: Timing) -> ActionResult:
        number = self._setting.first_step + step.index
        retry = f".{attempt}" if attempt else ""
        action = Action(
            f"{self._setting.repair}:{number}{retry}", step.name, step.parameters, timing.action_timeout_s
        )
        if self._setting.halt.is_set():
            raise _Stop(Ending.HALTED, "stopped before the plan was done")
        await self._intend(step, action)
        if self._setting.halt.is_set():  # the stop may have come while the intent went to disk
            await self._not_sent(step, action)
            raise _Stop(Ending.HALTED, "stopped before the plan was done")

        def feedback(code: int, message: str) -> None:
            if self._setting.feedback is not None:
                self._setting.feedback(step, code, message)

        try:
            async with asyncio.timeout(timing.action_timeout_s + 1.0):  # executors keep the bound themselves
                result = await self._setting.executors[step.name].execute(action, feedback)
        except TimeoutError:
            result = ActionResult(TIMED_OUT, f"no answer in {timing.action_timeout_s:g} s")
        except asyncio.CancelledError:
            # Cut off by a person, that is the outcome. Cut off because the service ends or has lost the
            # robot, the intent stays open: whoever takes over finds out whether it acted, or asks.
            if self._setting.halt.is_set():
                cancelled = ActionResult(CANCELLED, "cut off; whether it acted is unknown")
                await asyncio.shield(self._settle(step, action, cancelled, StepTrigger.WENT_WRONG))
            raise
        except Exception as error:  # noqa: BLE001  # whatever an executor of any kind may raise
            # An executor answers with results; one that raises is broken, and nobody knows what it did.
            result = ActionResult(TIMED_OUT, f"the executor failed: {type(error).__name__}: {error}")
        await self._settle(step, action, result)
        return result

    async def _intend(self, step: Step, action: Action) -> None:
        """Write the intent; one whose write is overtaken by a cancellation is written off, as not sent."""
        sending = self._report(step, StepTrigger.SENT, action_id=action.id, sent_ns=time.time_ns())
        writing = asyncio.ensure_future(self._setting.journal.intend(action, sending))
        try:
            await asyncio.shield(writing)
        except Withheld as reason:
            raise _Stop(Ending.HALTED, str(reason)) from None
        except asyncio.CancelledError:
            with contextlib.suppress(Withheld):
                await writing
                await self._not_sent(step, action)
            raise

    async def _not_sent(self, step: Step, action: Action) -> None:
        refused = ActionResult(REFUSED, "stopped before it was sent")
        report = self._report(step, StepTrigger.WENT_WRONG, result=refused, sent_ns=None)
        await self._setting.journal.settle(action, refused, report)

    async def _settle(
        self, step: Step, action: Action, result: ActionResult, what: StepTrigger | None = None
    ) -> None:
        """Write the outcome. What must not be repeated and may have acted stays open in the journal.

        It is settled when the question to a person is on disk, so that nothing that happens in between, be it
        a crash, a stop or a cancellation, loses the question.
        """
        changes = {} if what is None else {"reason": result.message}
        report = self._report(step, what, result=result, **changes)
        if not self._in_doubt(step, result):
            await self._setting.journal.settle(action, result, report)
        elif self._setting.report is not None:
            await self._setting.report(report)

    def _in_doubt(self, step: Step, result: ActionResult) -> bool:
        """Whether only a person can say if a step acted that must not be done twice."""
        return result.code in MAY_HAVE_ACTED and step.name in self._setting.not_idempotent

    async def _shows_anyway(self, step: Step, result: ActionResult, timing: Timing) -> bool:
        """An action without an answer may have acted: what counts is what OBS shows."""
        if result.code not in {TIMED_OUT, UNREACHABLE, FAILED}:
            return False
        await self._until_none(lambda: None if self._visible(step) else step, timing.hold_s)
        return self._visible(step)

    async def _await_effect(self, step: Step, wanted: frozenset[Literal], timeout_s: float) -> None:
        sight = self._setting.sight
        awaited = {
            literal
            for literal in wanted
            if literal.atom in self._setting.observed or sight.value(literal.atom) is not None
        }

        def missing() -> frozenset[Literal] | None:
            return frozenset(w for w in awaited if sight.value(w.atom) != w.positive) or None

        left = await self._until_none(missing, timeout_s) or frozenset()
        # Another step may have begun meanwhile and taken away what this one gave: not missing.
        left &= self._setting.prediction.expected()
        seen = tuple(sorted(awaited - left))
        self._agreed.update(seen)
        if left:
            names, was = " and ".join(map(str, sorted(left))), "was" if len(left) == 1 else "were"
            self._report(step, None, seen=seen, missing=tuple(sorted(left)))  # written with the reason
            raise _Stop(
                Ending.EFFECT_MISSING,
                f"{step} answered 'done', but {names} {was} not seen within {timeout_s:g} s",
                min(left),
            )
        await self._note(step, StepTrigger.EFFECT_SEEN, seen=seen)

    async def _until_none(self, wrong: Callable[[], T | None], timeout_s: float) -> T | None:
        """Wait until `wrong()` is None, looking at each change of OBS; return its last answer."""
        deadline = time.monotonic() + timeout_s
        sight = self._setting.sight
        while True:
            revision = sight.revision
            answer = wrong()
            left = deadline - time.monotonic()
            if answer is None or left <= 0:
                return answer
            await sight.changed(revision, min(left, 0.25))  # observations also grow stale, which is no change

    # --- the watch --------------------------------------------------------------------------------

    async def _watch(self) -> None:
        """Compare OBS with the predicted state; raise on a contradiction that lasts.

        Only what OBS once agreed with can break: what a step still has to bring about is that step's
        business.
        """
        agreed = self._agreed
        since: dict[Literal, float] = {}
        sight = self._setting.sight
        hold_s = self._setting.default_timing.hold_s
        while True:
            revision = sight.revision
            expected = self._setting.prediction.expected()
            agreed.intersection_update(expected)
            agreed.update(e for e in expected if sight.value(e.atom) == e.positive)
            broken = {e for e in agreed if sight.value(e.atom) == (not e.positive)}
            now = time.monotonic()
            since = {e: since.get(e, now) for e in broken}
            lasting = sorted(e for e, begun in since.items() if now - begun >= hold_s)
            if lasting:
                raise _Stop(
                    Ending.MISMATCH,
                    f"in the middle of the plan, {-lasting[0]} was seen where {lasting[0]} is expected",
                    lasting[0],
                )
            await sight.changed(revision, hold_s / 2 if broken else 1.0)

    def _report(self, step: Step, what: StepTrigger | None, **changes: object) -> StepReport:
        """Note what happened to a step, and what is known of it since."""
        report = self._reports[step.index]
        if what is not None:
            changes["state"] = state = after(STEP, report.state, what)
            if state in STEP_ENDS:
                changes["ended_ns"] = time.time_ns()
        report = replace(report, **changes)  # type: ignore[arg-type]  # fields by name
        self._reports[step.index] = report
        return report

    async def _note(self, step: Step, what: StepTrigger, **changes: object) -> None:
        report = self._report(step, what, **changes)
        if self._setting.report is not None:
            await self._setting.report(report)


async def _cancel(tasks: Collection[asyncio.Task[None]]) -> None:
    """Cancel and wait for the end, so that nothing acts after `execute` has returned."""
    for task in tasks:
        task.cancel()
    if tasks:
        await asyncio.wait(tasks, timeout=1.0)
    for task in tasks:
        if task.done() and not task.cancelled():
            task.exception()
