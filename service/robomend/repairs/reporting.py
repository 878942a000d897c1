"""How far each step of a plan came: noted as it happens, and told on."""

from __future__ import annotations

import time
from dataclasses import replace

from robomend.planning.plan import Plan, Step
from robomend.repairs.execution_values import Setting, StepReport
from robomend.repairs.states import STEP, STEP_ENDS, StepTrigger
from robomend.transitions import after


class Reporting:
    """The reports of one execution's steps."""

    def __init__(self, plan: Plan, setting: Setting) -> None:
        self._setting = setting
        self._reports = [StepReport(step) for step in plan.steps]

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
