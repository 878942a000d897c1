"""Carry out a plan: check, send, and look whether it worked, step by step.

    predecessors done ──► permitted? ──► preconditions hold in OBS? ──► effect already there? ── yes ──► done;
                                                                            │ no            of power: mismatch
        done ◄── OBS shows the effect ◄── await it ◄── result 0 ◄── send ◄── journal the intent

Steps that the plan does not order run side by side. While they run, a watch compares OBS with the state
that the plan predicts; a contradiction that lasts is a mismatch. Nothing here repairs a mismatch: execution
ends, says which literal it saw, and the loop diagnoses and plans again. A plan is never trusted beyond what
was seen.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Collection
from dataclasses import replace
from functools import partial

from robomend.planning.plan import Plan, Step
from robomend.repairs.execution_values import (
    MAY_HAVE_ACTED,
    MOST_FEEDBACK,
    RUNS_ALREADY,
    Ending,
    Execution,
    LatestFeedback,
    Setting,
    StepReport,
    Timing,
    Withheld,
    failure,
    found_running,
)
from robomend.repairs.looking import Looking, first_of
from robomend.repairs.states import STEP, STEP_ENDS, StepState, StepTrigger
from robomend.repairs.throttle import Throttle
from robomend.robots.clock import CLOCK
from robomend.transitions import after
from robomend_client.actions import (
    CANCELLED,
    FAILED,
    OK,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
)
from robomend_client.literals import Atom, Literal

WAITED_NS = 10**7
"""After a longer wait for what a step needs, it is looked again whether what it acts on is good by now."""

# --- how far each step of a plan came: noted as it happens, and told on.
#
# Feedback of an action on its way comes as often as its executor likes; it is told at most every
# FEEDBACK_S.

FEEDBACK_S = 1.0
"""Between two feedbacks of one step that are told."""


class Reporting:
    """The reports of one execution's steps."""

    def __init__(self, plan: Plan, setting: Setting) -> None:
        self._setting = setting
        self._reports = [StepReport(step) for step in plan.steps]
        self._feedback = Throttle(FEEDBACK_S, self._tell_feedback)

    @property
    def all(self) -> tuple[StepReport, ...]:
        """The steps as they are now, in the order of the plan."""
        return tuple(self._reports)

    def note(self, step: Step, what: StepTrigger | None, **changes: object) -> StepReport:
        """Note what happened to a step, and what is known of it since; return how far it is."""
        report = self._reports[step.index]
        if what is not None:
            changes["state"] = state = after(STEP, report.state, what)
            if state in STEP_ENDS:
                changes["ended_ns"] = time.time_ns()
        report = replace(report, **changes)  # type: ignore[arg-type]  # fields by name
        self._reports[step.index] = report
        return report

    async def tell(self, step: Step, what: StepTrigger | None, **changes: object) -> None:
        """Note it, and tell whoever asked for it."""
        report = self.note(step, what, **changes)
        if self._setting.report is not None:
            await self._setting.report(report)

    def feedback(self, step: Step, code: int, message: str) -> None:
        """An action under way says how far it is; the latest counts."""
        before = self._reports[step.index].feedback
        cut = message if len(message) <= MOST_FEEDBACK else f"{message[: MOST_FEEDBACK - 1]}…"
        if before is None or (before.code, before.message) != (code, cut):
            self.note(step, None, feedback=LatestFeedback(code, cut, time.time_ns()))
            self._feedback.ask(step.index)

    async def close(self) -> None:
        """Tell nothing more."""
        await self._feedback.close()

    async def _tell_feedback(self, index: int) -> None:
        report = self._reports[index]
        if report.state is StepState.RUNNING and self._setting.report is not None:  # else it is told already
            await self._setting.report(report)


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
        self._reporting = Reporting(plan, setting)
        self._done: set[int] = set()
        self._looking = Looking(setting, plan.steps)
        self._tasks: dict[asyncio.Task[None], int] = {}
        self._kept: set[str] = set()  # what was good before its step came: neither stopped nor started

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
            await self._reporting.close()
        if stop is None:
            stop = _Stop(Ending.DONE, "every effect was seen")
        return Execution(stop.ending, stop.reason, self._reporting.all, stop.mismatch, frozenset(self._kept))

    async def _halted(self) -> None:
        await self._setting.halt.wait()

    def _start_ready(self) -> None:
        started = self._done | set(self._tasks.values())
        for step in sorted(self._plan.steps, key=self._setting.later):
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
        """Return the stop of a step that a person must look at, whatever else ended the plan before it.

        One of which nothing was sent yet only waits, be it a minute for a device to boot: it ends at once.
        """
        reports = self._reporting.all
        waiting = {task for task, index in self._tasks.items() if reports[index].sent_ns is None}
        await _cancel(waiting)
        for task in waiting:
            del self._tasks[task]
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
            if await self._is_kept(step):
                return
            asked_ns = CLOCK.now_ns()
            await self._check_permitted(step)
            if CLOCK.now_ns() - asked_ns > WAITED_NS and await self._is_kept(step):
                return
            await self._check_preconditions(step, timing)
            if self._looking.visible(step):
                if (
                    step.name == "power_up"
                ):  # the rest of the plan is for what was off until we switched it on
                    why = f"{step}: it is on already, and not by this plan"
                    raise _Stop(Ending.MISMATCH, why, Literal(Atom("on", step.parameters)))
                self._setting.prediction.begin(step)
                self._setting.prediction.finish(step)
                await self._reporting.tell(
                    step, StepTrigger.EFFECT_THERE, reason="its effect was already there"
                )
                return
            nothing_yet = all(report.sent_ns is None for report in self._reporting.all)
            if nothing_yet and (moot := await self._setting.moot()) is not None:
                raise _Stop(Ending.MISMATCH, f"{step}: {moot}")
            sent_ns = CLOCK.now_ns()
            wanted = await self._act(step, timing)
            await self._await_effect(step, wanted, timing.effect_timeout_s, sent_ns)
        except _Stop as stop:
            await self._reporting.tell(step, StepTrigger.WENT_WRONG, reason=stop.reason)
            raise

    async def _is_kept(self, step: Step) -> bool:
        """Return whether a step is left out, as what it acts on is good by the newest evidence.

        What was not stopped for that is not started either.
        """
        if self._kept.issuperset(step.parameters) and step.parameters:
            why = "it was good already, and was not touched"
        elif (found := await self._setting.well(step)) is not None:
            why = found
            self._kept.update(step.parameters)
        else:
            return False
        if step.name == "start_node":
            self._setting.prediction.finish(step)
        await self._reporting.tell(step, StepTrigger.EFFECT_THERE, reason=why)
        return True

    async def _check_permitted(self, step: Step) -> None:
        refusal = await self._setting.permit(step)
        if refusal is not None:
            raise _Stop(Ending.NOT_PERMITTED, f"{step}: {refusal}")
        if step.name not in self._setting.executors:
            raise _Stop(Ending.NOT_PERMITTED, f"{step}: no executor is configured for {step.name!r}")

    async def _check_preconditions(self, step: Step, timing: Timing) -> None:
        literal = await self._looking.wrong_before(step, timing)
        if literal is None or self._looking.visible(step):
            return
        if not self._looking.known(literal.atom):
            raise _Stop(
                Ending.STALE, f"{step}: {literal} is no longer reported; nothing acts on old news", literal
            )
        raise _Stop(Ending.MISMATCH, f"{step}: expected {literal} before it, but saw {-literal}", literal)

    async def _act(self, step: Step, timing: Timing) -> frozenset[Literal]:
        """Send the action, again after a failure if it may be; return the literals that it makes expected."""
        prediction = self._setting.prediction
        prediction.begin(step)
        result, sent_ns = ActionResult(FAILED, "not sent"), CLOCK.now_ns()
        for attempt in range(timing.retries + 1):
            if attempt:
                await asyncio.sleep(timing.backoff_s * 2 ** (attempt - 1))
                await self._check_permitted(step)
                if self._looking.visible(step) or self._setting.again(step) is not None:
                    break
            result = await self._send(step, attempt, timing)
            if result.ok or result.code == REFUSED:
                break
            if self._in_doubt(step, result):
                wanted = await self._seen_all_the_same(step, attempt, timing, sent_ns)
                if wanted is not None:
                    return wanted
                raise _Stop(Ending.UNKNOWN_OUTCOME, f"{failure(step, result)}; it must not be sent twice")
        if not result.ok:
            # An action without an answer may have acted: what counts is what OBS shows.
            counts = result.code in {TIMED_OUT, UNREACHABLE, FAILED}
            if not (counts and await self._looking.becomes_visible(step, timing.hold_s)):
                raise _Stop(Ending.ACTION_FAILED, failure(step, result))
        # Across `finish` alone: what other steps brought about meanwhile is theirs to await.
        before = prediction.expected()
        prediction.finish(step)
        return prediction.expected() - before

    async def _seen_all_the_same(
        self, step: Step, attempt: int, timing: Timing, sent_ns: int
    ) -> frozenset[Literal] | None:
        """Return what the action makes expected, if OBS shows that it has acted though it did not answer: its
        outcome is known then, and written. None: nobody knows whether it acted.
        """
        prediction = self._setting.prediction
        before = prediction.expected()
        prediction.finish(step)
        wanted = prediction.expected() - before
        if not await self._looking.came_since(wanted, sent_ns, timing.effect_timeout_s):
            return None
        done = ActionResult(OK, f"no answer in {timing.action_timeout_s:g} s, but its effect was seen")
        action = self._action(step, attempt, timing)
        await self._setting.journal.settle(action, done, self._reporting.note(step, None, result=done))
        return wanted

    def _action(self, step: Step, attempt: int, timing: Timing) -> Action:
        number = self._setting.first_step + step.index
        retry = f".{attempt}" if attempt else ""
        return Action(
            f"{self._setting.repair}:{number}{retry}", step.name, step.parameters, timing.action_timeout_s
        )

    async def _send(self, step: Step, attempt: int, timing: Timing) -> ActionResult:
        action = self._action(step, attempt, timing)
        if self._setting.halt.is_set():
            raise _Stop(Ending.HALTED, "stopped before the plan was done")
        await self._intend(step, action)
        if self._setting.halt.is_set():  # the stop may have come while the intent went to disk
            await self._not_sent(step, action)
            raise _Stop(Ending.HALTED, "stopped before the plan was done")
        if (why := self._setting.interlocked()) is not None:
            await self._not_sent(step, action, why)
            raise _Stop(Ending.NOT_PERMITTED, f"{step}: {why}")

        await self._setting.confirm()  # whoever slept since may have lost the robot
        feedback = partial(self._reporting.feedback, step)
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
        sending = self._reporting.note(step, StepTrigger.SENT, action_id=action.id, sent_ns=time.time_ns())
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

    async def _not_sent(self, step: Step, action: Action, why: str = "stopped before it was sent") -> None:
        refused = ActionResult(REFUSED, why)
        report = self._reporting.note(step, StepTrigger.WENT_WRONG, result=refused, sent_ns=None)
        await self._setting.journal.settle(action, refused, report)

    async def _settle(
        self, step: Step, action: Action, result: ActionResult, what: StepTrigger | None = None
    ) -> None:
        """Write the outcome. What must not be repeated and may have acted stays open in the journal.

        It is settled when the question to a person is on disk, so that nothing that happens in between, be it
        a crash, a stop or a cancellation, loses the question.
        """
        changes = {} if what is None else {"reason": result.message}
        if self._in_doubt(step, result):
            await self._reporting.tell(step, what, result=result, **changes)
        else:
            report = self._reporting.note(step, what, result=result, **changes)
            await self._setting.journal.settle(action, result, report)

    def _in_doubt(self, step: Step, result: ActionResult) -> bool:
        """Whether only a person can say if a step acted that must not be done twice."""
        return result.code in MAY_HAVE_ACTED and step.name in self._setting.not_idempotent

    async def _await_effect(
        self, step: Step, wanted: frozenset[Literal], timeout_s: float, sent_ns: int
    ) -> None:
        seen, missing, within = await self._looking.effect(step.name, wanted, timeout_s, sent_ns)
        if missing:
            names, was = first_of(missing), "was" if len(missing) == 1 else "were"
            result = self._reporting.all[step.index].result
            found = result is not None and found_running(step.name, result.message)
            answer = f"'{RUNS_ALREADY}'" if found else "'done'"
            self._reporting.note(step, None, seen=seen, missing=missing)  # written with the reason
            why = f"{step} answered {answer}, but {names} {was} not seen within {within}"
            ran = Literal(Atom("running", step.parameters))
            if ran in missing and (self._setting.sight.fell_ns(ran.atom) or 0) > sent_ns:
                why = _ended_again(ran)
            raise _Stop(Ending.EFFECT_MISSING, why, missing[0])
        await self._reporting.tell(step, StepTrigger.EFFECT_SEEN, seen=seen)

    async def _watch(self) -> None:
        """Raise when OBS contradicts the state that the plan predicts."""
        literal = await self._looking.contradiction()
        why = f"in the middle of the plan, {-literal} was seen where {literal} is expected"
        starts = [step.parameters for step in self._plan.steps if step.name == "start_node"]
        if literal in {Literal(Atom("running", started)) for started in starts}:
            why = _ended_again(literal)
        raise _Stop(Ending.MISMATCH, why, literal)


def _ended_again(ran: Literal) -> str:
    return f"{ran.atom.args[0]} ended again after its start"


async def _cancel(tasks: Collection[asyncio.Task[None]]) -> None:
    """Cancel and wait for the end, so that nothing acts after `execute` has returned."""
    for task in tasks:
        task.cancel()
    if tasks:
        await asyncio.wait(tasks, timeout=1.0)
    for task in tasks:
        if task.done() and not task.cancelled():
            task.exception()
