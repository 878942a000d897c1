"""How far each step of a plan came: noted as it happens, and told on.

Feedback of an action on its way comes as often as its executor likes; it is told at most every FEEDBACK_S.
"""

from __future__ import annotations

import time
from dataclasses import replace

from robomend.planning.plan import Plan, Step
from robomend.repairs.execution_values import MOST_FEEDBACK, LatestFeedback, Setting, StepReport
from robomend.repairs.states import STEP, STEP_ENDS, StepState, StepTrigger
from robomend.repairs.throttle import Throttle
from robomend.transitions import after

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
