"""One-shots in the service: questions without a robot, and probes, in worker processes.

A bounded number waits for a worker; more are refused. Nothing of a one-shot stays but a warm engine.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from robomend.diagnosis.probes import ProbeResult
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.errors import InputError, Overloaded
from robomend.model.system import System, variant
from robomend.oneshots.solvers import SolverWorkers
from robomend.oneshots.warm_model import PackedQuestion, Question, given_diagnosis, supposing
from robomend.planning.advice import Situation, parts_of
from robomend.planning.choice import Choice
from robomend.planning.drill import PlantableFault
from robomend.planning.faults import DrilledBoard
from robomend.planning.planner_pool import PlannerPool, advise
from robomend.planning.planners import PLANNERS
from robomend.planning.planning import PlanOptions
from robomend.planning.protection import Protection
from robomend.settings import Settings
from robomend_client.literals import Atom, Literal

GRACE_S = 2.0


@dataclass(frozen=True, slots=True)
class Subject:
    """What is asked about: a system, and the version by which a worker knows its engine again."""

    version: str
    system: System

    def extended(self, asked: Question, expected_stopped: Iterable[str] = ()) -> Subject:
        """Return the subject with what a question says beyond literals."""
        stopped = self.system.named(expected_stopped)
        version = variant(self.version, asked.assertions, stopped)
        return Subject(version, self.system.extended(asked.assertions, stopped))


class OneShots:
    """See the module. Belongs to one event loop."""

    def __init__(self, solver: SolverWorkers, planners: PlannerPool, settings: Settings) -> None:
        self._solver = solver
        self._planners = planners
        self._settings = settings
        self._room = settings.one_shots
        self._closed = False

    @property
    def alive(self) -> bool:
        """Whether workers can be had; they start when they are first needed."""
        return not self._closed

    def close(self) -> None:
        """Refuse what comes from now on; the pools belong to whoever made them."""
        self._closed = True

    async def diagnose(
        self, subject: Subject, asked: Question, engine: str, options: Options
    ) -> DiagnosisResult:
        """Return the diagnoses.

        Raises:
            UnknownComponent, OptionRefused: what was sent is at fault.
            ContradictoryModel: no model even with everything abnormal.
            Overloaded: too many one-shots wait.
        """
        options = supposing(options, subject.system)
        return await self._ask(subject.extended(asked), asked.literals, engine, options)

    async def answer(self, asked: PackedQuestion, engine: str) -> bytes:
        """Return the diagnoses as JSON text; raises as `diagnose` does."""
        with self._place():
            return await self._solver.answer(engine, asked, self._deadline_s(asked.options))

    async def plan(
        self,
        subject: Subject,
        asked: Question,
        *,
        bad: Sequence[str] | None,
        expected_stopped: Sequence[str],
        planner: str,
        timeout_s: float,
        pddl: bool,
    ) -> Choice:
        """Return what to do first, and the alternatives; for the components `bad`, or for the diagnoses.

        Raises:
            ModelError: the model says nothing of what can be repaired.
            UnknownComponent: `bad` or `expected_stopped` speaks of what the model does not have.
            InputError: no diagnosis was found in time.
            OptionRefused: no such planner.
            Overloaded: too many one-shots wait.
        """
        PLANNERS.check(planner)
        parts = parts_of(subject.system)
        stopped = subject.system.named(expected_stopped)
        if bad is not None:
            result = given_diagnosis(bad, subject.system)
        else:
            result = await self._ask(
                subject.extended(asked, stopped), asked.literals, "sat", Options(timeout_s=timeout_s)
            )
            if not result.diagnoses:
                raise InputError(
                    "no diagnosis was found in time: name the bad components, or allow more time"
                )
        options = PlanOptions(planner=planner, timeout_s=timeout_s, expected_stopped=stopped, pddl=pddl)
        situation = Situation(parts, tuple(sorted(asked.literals)), result, cnf=subject.system.cnf)
        with self._place():
            return await advise(self._planners, situation, options)

    async def probes(
        self, version: str, system: System, literals: frozenset[Literal], engine: str, limit: int
    ) -> ProbeResult:
        """Return the observations worth making next; raises as `diagnose` does."""
        options = Options(timeout_s=self._settings.solver_timeout_s)
        deadline_s = 2 * self._settings.solver_timeout_s + GRACE_S
        with self._place():
            return await self._solver.probes(
                version, engine, system.cnf, literals, options, limit, deadline_s
            )

    async def isolability(
        self, system: System, observed: Collection[Atom] | None, *, double: bool, timeout_s: float
    ) -> str:
        """Return which faults can be detected and told apart by what is observed (None: by all
        there is), as JSON.

        Raises:
            OptionRefused: too large a model, or no rule speaks of what is observed.
            Overloaded: too many one-shots wait.
        """
        with self._place():
            return await self._solver.isolability(system, observed, double, timeout_s)

    async def drill_plan(
        self,
        system: System,
        observed: Collection[Atom],
        *,
        protected: Protection,
        board: DrilledBoard | None,
        meant_off: Collection[str],
        timeout_s: float,
    ) -> tuple[list[PlantableFault], bool]:
        """Return what each fault that could be planted would show (robomend.planning.drill), as far as the
        time goes, and whether that is all.
        """
        system = system.extended(expected_stopped=system.named(meant_off))
        options = {"protected": protected, "board": board, "meant_off": meant_off}
        with self._place():
            return await self._solver.drill_plan(system, observed, options, timeout_s)

    async def _ask(
        self, subject: Subject, literals: frozenset[Literal], engine: str, options: Options
    ) -> DiagnosisResult:
        deadline_s = self._deadline_s(options)
        with self._place():
            return await self._solver.diagnose(
                subject.version, engine, subject.system.cnf, literals, options, deadline_s
            )

    def _deadline_s(self, options: Options) -> float:
        return (options.timeout_s or self._settings.max_solver_timeout_s) + GRACE_S

    @contextmanager
    def _place(self) -> Iterator[None]:
        """Take a place among the one-shots that may wait; Overloaded when there is none."""
        if self._room <= 0:
            raise Overloaded("too many one-shots wait for a worker already; try again later")
        self._room -= 1
        try:
            yield
        finally:
            self._room += 1
