"""Stateless questions: model and observations in, result or plan out, what-if included. All in workers.

Nothing of a one-shot stays in the service but a warm engine; a stored model is asked for by its name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from robomend.diagnosis.probes import ProbeResult
from robomend.diagnosis.result import Diagnosis, DiagnosisResult, Options
from robomend.errors import InputError, Overloaded, UnknownComponent
from robomend.model.budget import check_steps
from robomend.model.packed import supposed
from robomend.model.system import System
from robomend.observations.language import Assertion, parse, says_literals
from robomend.oneshots.answers import result_json
from robomend.oneshots.solvers import SolverWorkers
from robomend.planning.advice import Situation, parts_of, plan_answer
from robomend.planning.planner_pool import PlannerPool, advise
from robomend.planning.planners import PLANNERS
from robomend.planning.planning import PlanOptions
from robomend.robots.robot import Robot
from robomend.robots.systems import Systems
from robomend.settings import Settings
from robomend.turns import Turns
from robomend_client.literals import Literal

GRACE_S = 2.0


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked about: a stored model or a text, and sentences about it."""

    model: str | None
    source: str | None
    observations: tuple[str, ...]


class OneShots:
    """See the module. Belongs to one event loop."""

    def __init__(
        self, systems: Systems, solver: SolverWorkers, planners: PlannerPool, settings: Settings
    ) -> None:
        self._systems = systems
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

    async def diagnose(self, question: Question, engine: str, options: Options) -> dict[str, Any]:
        """Return the diagnoses as JSON.

        Raises:
            ModelError, ObservationError, UnknownComponent, OptionRefused: what was sent is at fault.
            ContradictoryModel: no model even with everything abnormal.
            Overloaded: too many one-shots wait.
        """
        return result_json(await self._diagnose(question, engine, options))

    async def plan(
        self,
        question: Question,
        *,
        bad: Sequence[str] | None,
        expected_stopped: tuple[str, ...],
        planner: str,
        timeout_s: float,
        pddl: bool,
    ) -> dict[str, Any]:
        """Return what to do first, the alternatives and the plan as JSON: what `robomend plan` answers too.

        Raises:
            ModelError: the model says nothing of what can be repaired.
            InputError: no diagnosis was found in time.
            OptionRefused: no such planner.
        """
        PLANNERS.check(planner)
        version, system, literals = await self._understand(question)
        parts = parts_of(system)
        _check(expected_stopped, system)
        if bad is not None:
            _check(bad, system)
            wanted = (Diagnosis(tuple(bad)),)
            result = DiagnosisResult(system.cnf.components, wanted, True, None, (), 0.0)
        else:
            if expected_stopped:
                version = f"{version}-{','.join(sorted(expected_stopped))}"
                system = replace(system, cnf=supposed(system.cnf, expected_stopped, ()))
            result = await self._ask(version, system, literals, "sat", Options(timeout_s=timeout_s))
            if not result.diagnoses:
                raise InputError(
                    "no diagnosis was found in time: name the bad components, or allow more time"
                )
        options = PlanOptions(
            planner=planner, timeout_s=timeout_s, expected_stopped=expected_stopped, pddl=pddl
        )
        async with self._turn():
            choice = await advise(self._planners, Situation(parts, tuple(literals), result), options)
        return plan_answer(choice, system.cnf.components)

    async def probes(self, state: Robot, limit: int) -> ProbeResult:
        """Return the observations of a robot worth making next."""
        version, system, literals = state.question()
        options = Options(timeout_s=self._settings.solver_timeout_s)
        deadline_s = 2 * self._settings.solver_timeout_s + GRACE_S
        async with self._turn():
            return await self._solver.probes(
                version, state.config.engine, system.cnf, literals, options, limit, deadline_s
            )

    async def _diagnose(self, question: Question, engine: str, options: Options) -> DiagnosisResult:
        version, system, literals = await self._understand(question)
        _check(options.healthy | options.abnormal, system)
        return await self._ask(version, system, literals, engine, options)

    async def _understand(self, question: Question) -> tuple[str, System, frozenset[Literal]]:
        """Return the version, the system extended by what says more than literals, and the literals."""
        if (question.model is None) == (question.source is None):
            raise InputError("give either `model`, the name of a stored one, or `source`, a model's text")
        if question.model is not None:
            model, system = await self._systems.current(question.model)
            version = f"{model.name}@{model.version}"
        else:
            assert question.source is not None
            system = await self._systems.readers.model(question.source, name=None, format=None, guest=True)
            version = "text:" + hashlib.sha256(question.source.encode()).hexdigest()
        literals: set[Literal] = set()
        assertions: list[Assertion] = []
        turns, steps = Turns(), 0
        for index, sentence in enumerate(question.observations):
            if says_literals(sentence, system.vocabulary):
                literals.update(parse(sentence, system.vocabulary))
            else:
                name = f"sentence {index}"
                said = await self._systems.readers.assertion(
                    version, system.vocabulary, name, sentence, guest=True
                )
                steps += said.steps
                check_steps(steps, self._settings.max_assertion_steps, sentence)
                assertions.append(said)
            await turns.rest()
        _check_consistent(literals)
        if not assertions:
            return version, system, frozenset(literals)
        text = "\n".join(assertion.text for assertion in assertions)
        version = f"{version}+{hashlib.sha256(text.encode()).hexdigest()[:16]}"
        cnf = supposed(system.cnf, (), tuple(assertions))
        return version, replace(system, cnf=cnf), frozenset(literals)

    async def _ask(
        self, version: str, system: System, literals: frozenset[Literal], engine: str, options: Options
    ) -> DiagnosisResult:
        deadline_s = (options.timeout_s or self._settings.max_solver_timeout_s) + GRACE_S
        async with self._turn():
            return await self._solver.diagnose(version, engine, system.cnf, literals, options, deadline_s)

    def _turn(self) -> _Turn:
        return _Turn(self)


class _Turn:
    """A place among the one-shots that may wait; Overloaded when there is none."""

    def __init__(self, shots: OneShots) -> None:
        self._shots = shots

    async def __aenter__(self) -> None:
        if self._shots._room <= 0:
            raise Overloaded("too many one-shots wait for a worker already; try again later")
        self._shots._room -= 1

    async def __aexit__(self, *_: object) -> None:
        self._shots._room += 1


def _check(names: Sequence[str] | frozenset[str], system: System) -> None:
    known = frozenset(system.cnf.components)
    for name in names:
        if name not in known:
            raise UnknownComponent(name, known)


def _check_consistent(literals: set[Literal]) -> None:
    """Sentences of one question are about one moment, so a literal and its opposite are a mistake."""
    for literal in sorted(literals):
        if literal.positive and -literal in literals:
            raise InputError(f"the observations hold both {literal} and {-literal}")
