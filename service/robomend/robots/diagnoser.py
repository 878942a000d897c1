"""Diagnoses for every robot of the service, without one of them keeping another waiting.

    seen before? ── yes ──► the cached answer
         │ no
    small model, within budget? ── yes ──► on the event loop: fractions of a millisecond, cheaper than
         │ no                              any hand-over
    a worker process with a deadline; the model's engine stays warm there

One engine per model version serves all robots that follow it. A model whose diagnoses break the budget of
the event loop goes to the workers until it is changed, so a monstrous model is slow alone. A thread would
not do: the search is Python around a solver, and Python's part would take the interpreter from the event
loop for 5 ms at a time.

The cache is exact: the key is the model version, the options, and the set of observed literals.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

from robomend.diagnosis.engines import ENGINES, make_engine
from robomend.diagnosis.result import DiagnosisResult, Engine, Minimal, Options, healthy
from robomend.errors import RobomendError
from robomend.memory_limits import memory_unlimited
from robomend.metrics import Metrics
from robomend.model.cnf import HealthCnf
from robomend.model.packed import PackedCnf
from robomend.model.system import System
from robomend.oneshots.result_json import result_json, timeless
from robomend.oneshots.solvers import SolverWorkers
from robomend.oneshots.warm_model import ask_engine
from robomend.robots.configuration import RobotConfig
from robomend.settings import Settings
from robomend.store import Transaction, diagnoses
from robomend.store.encoding import Common, Encoded, to_json
from robomend.store.records import StoredDiagnosis
from robomend_client.literals import Literal

CACHED = 4096
"""Answers kept, over all models."""

WARM = 64
"""Warm engines kept on the event loop; beyond, the one that was not asked for longest is closed."""

STRIKES = 3
"""Diagnoses over budget before their model leaves the event loop: one may be the first, or a pause."""

FORGIVEN = 1 / 1000
"""Of a strike, by each diagnosis within the budget: a model that is seldom slow stays, for how long ever."""

Key = tuple[str, str, Options, frozenset[Literal]]

GRACE_S = 2.0
"""Beyond the engine's own time-out, before its worker is killed."""


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """An engine's answer or the error that it gave, with its JSON made once for all who want it."""

    result: DiagnosisResult | None
    fault: RobomendError | None
    json: dict[str, Any] | None
    key: str  # equal for equal answers, whatever time they took
    took: str | None = None  # behind the key it makes the text of `json`
    bad_sets: tuple[tuple[str, ...], ...] | None = None  # what each diagnosis blames; None without a result
    healthy: bool = False  # none of them blames anybody
    kept_as: dict[tuple[str, tuple[str, ...]], Common] = field(default_factory=dict, compare=False)
    """What the store keeps of it, for a model version and what is not expected to run; see `Current`."""

    @classmethod
    def of(cls, result: DiagnosisResult) -> Diagnosed:
        """Return the answer for a result."""
        values = result_json(result)
        text = to_json(values)
        key = timeless(text)
        bad_sets = tuple(tuple(diagnosis["bad"]) for diagnosis in values["diagnoses"])
        return cls(result, None, values, key, text[len(key) :], bad_sets, healthy(bad_sets))

    @classmethod
    def failed(cls, fault: RobomendError) -> Diagnosed:
        """Return the answer for an error."""
        return cls(None, fault, None, f"{fault.code}: {fault}")

    def result_or_fault(self) -> DiagnosisResult:
        """Return the result; raise the error if that is the answer."""
        if self.result is None:
            assert self.fault is not None
            raise self.fault
        return self.result


class Diagnoser:
    """See the module. Belongs to one event loop."""

    def __init__(self, settings: Settings, metrics: Metrics, workers: SolverWorkers) -> None:
        self._settings = settings
        self._metrics = metrics
        self._workers = workers
        self._cache: OrderedDict[Key, Diagnosed] = OrderedDict()
        self._engines: OrderedDict[tuple[str, str], Engine] = OrderedDict()
        self._slow: set[tuple[str, str]] = set()
        self._strikes: dict[tuple[str, str], float] = {}
        self._turns: dict[tuple[str, str], asyncio.Lock] = {}
        self._at_once = memory_unlimited()
        if self._at_once:
            # Its solvers take 30 ms to load, for which the first robot's diagnosis would hold the event loop.
            ENGINES.load("sat")
        self._seen_before = metrics.diagnoses.labels("cache")  # looking a label up costs more than counting

    async def diagnose(
        self, version: str, system: System, literals: Iterable[Literal], engine: str, options: Options
    ) -> Diagnosed:
        """Return the answer for these observations; errors of the model or the engine are answers too."""
        observed = frozenset(literals)
        answer = self.at_once(version, system, observed, engine, options)
        if answer is not None:
            return answer
        try:
            answer = await self._in_worker(version, system, observed, engine, options)
        except RobomendError as fault:
            answer = self._failed(fault)
        return self._remember((version, engine, options, observed), answer)

    def at_once(
        self,
        version: str,
        system: System,
        observed: frozenset[Literal],
        engine: str,
        options: Options,
    ) -> Diagnosed | None:
        """Return the answer if it is known, or found within the event loop's budget; else None."""
        key = (version, engine, options, observed)
        answer = self._cache.get(key)
        if answer is not None:
            self._cache.move_to_end(key)
            self._seen_before.inc()
            return answer
        try:
            answer = self._inline(version, system, observed, engine, options)
        except RobomendError as fault:
            answer = self._failed(fault)
        return None if answer is None else self._remember(key, answer)

    def _failed(self, fault: RobomendError) -> Diagnosed:
        self._metrics.failures.labels(fault.code).inc()
        return Diagnosed.failed(fault)

    def _remember(self, key: Key, answer: Diagnosed) -> Diagnosed:
        """Keep an answer that asking again would not better."""
        if answer.result is None:
            final = answer.fault is not None and answer.fault.code == "contradictory-model"
        else:
            final = answer.result.stopped_by != "time"
        if final:
            self._cache[key] = answer
            while len(self._cache) > CACHED:
                self._cache.popitem(last=False)
        return answer

    def forget(self, version: str) -> None:
        """Close the engines of a model version that no robot follows any more."""
        for key in [key for key in self._engines if key[0] == version]:
            self._engines.pop(key).close()
        self._slow = {key for key in self._slow if key[0] != version}
        for struck in [key for key in self._strikes if key[0] == version]:
            del self._strikes[struck]
        for held in [key for key in self._turns if key[0] == version and not self._turns[key].locked()]:
            del self._turns[held]

    def close(self) -> None:
        """Close all engines."""
        for engine in self._engines.values():
            engine.close()
        self._engines.clear()

    def _inline(
        self, version: str, system: System, observed: frozenset[Literal], engine: str, options: Options
    ) -> Diagnosed | None:
        """Diagnose here and now; None if that is not for the event loop, or took too long to finish."""
        if (version, engine) in self._slow:
            return None
        if (
            engine != "sat"
            or isinstance(system.cnf, PackedCnf)
            or len(system.cnf.components) > self._settings.inline_components
            or not self._at_once
        ):
            self._slow.add((version, engine))
            return None
        budget_s = min(4 * self._settings.inline_budget_s, options.timeout_s or float("inf"))
        warm = self._warm(version, engine, system.cnf)
        began = time.thread_time()  # not the wall's: what others take of the processor is no model's fault
        result = ask_engine(warm, system.cnf, observed, replace(options, timeout_s=budget_s))
        self._judge((version, engine), time.thread_time() - began)
        if result.stopped_by == "time" and budget_s != options.timeout_s:
            return None
        self._note(result, "inline")
        return Diagnosed.of(result)

    def _judge(self, model: tuple[str, str], took_s: float) -> None:
        """Have a model leave the event loop that has held it too long too often."""
        strikes = self._strikes.get(model, 0.0)
        if took_s <= self._settings.inline_budget_s:
            if strikes:
                self._strikes[model] = max(0.0, strikes - FORGIVEN)
            return
        self._strikes[model] = strikes + 1
        if strikes + 1 >= STRIKES:
            self._slow.add(model)

    def _warm(self, version: str, name: str, cnf: HealthCnf) -> Engine:
        engine = self._engines.get((version, name))
        if engine is None:
            engine = self._engines[version, name] = make_engine(name, cnf)
            while len(self._engines) > WARM:
                self._engines.popitem(last=False)[1].close()
        self._engines.move_to_end((version, name))
        return engine

    async def _in_worker(
        self, version: str, system: System, observed: frozenset[Literal], engine: str, options: Options
    ) -> Diagnosed:
        turn = self._turns.setdefault((version, engine), asyncio.Lock())
        async with turn:  # a slow model takes one worker at most, whatever number of robots follow it
            timeout_s = options.timeout_s or self._settings.max_solver_timeout_s
            bounded = replace(options, timeout_s=timeout_s)
            result = await self._workers.diagnose(
                version, engine, system.cnf, observed, bounded, timeout_s + GRACE_S
            )
        self._note(result, "worker")
        return Diagnosed.of(result)

    def _note(self, result: DiagnosisResult, place: str) -> None:
        self._metrics.diagnoses.labels(place).inc()
        self._metrics.diagnosis_s.observe(result.elapsed_s)


def how(config: RobotConfig, settings: Settings) -> tuple[str, Options]:
    """Return by which engine a robot is diagnosed, and how far that searches."""
    minimal: Minimal = "cardinality" if config.minimal == "cardinality" else "subset"
    timeout_s = min(config.timeout_s or settings.solver_timeout_s, settings.max_solver_timeout_s)
    return config.engine, _options(minimal, config.max_size, config.limit, timeout_s)


@lru_cache(maxsize=256)
def _options(minimal: Minimal, max_size: int | None, limit: int | None, timeout_s: float) -> Options:
    return Options(minimal=minimal, max_size=max_size, limit=limit, timeout_s=timeout_s)


# --- the diagnosis that a robot has now, and whether a new one says anything new.


class Current(NamedTuple):
    """A diagnosis of one revision of OBS, as it is published."""

    revision: int
    model_version: str
    time_ns: int
    result: dict[str, Any] | None  # JSON
    fault: dict[str, Any] | None  # why there is none
    answer: Diagnosed | None  # None: made by another instance, or before a restart
    expected_stopped: tuple[str, ...] = ()  # what the diagnosis does not expect to run

    @classmethod
    def of(
        cls, revision: int, model_version: str, answer: Diagnosed, expected_stopped: tuple[str, ...]
    ) -> Current:
        """Return the diagnosis that was just made."""
        fault = None if answer.fault is None else {"code": answer.fault.code, "detail": str(answer.fault)}
        return cls(revision, model_version, time.time_ns(), answer.json, fault, answer, expected_stopped)

    @classmethod
    def published(cls, revision: int, time_ns: int, data: Mapping[str, Any]) -> Current:
        """Return a diagnosis that was made by another instance, or before a restart."""
        version = data.get("model_version") or ""
        stopped = tuple(data.get("expected_stopped", ()))
        return cls(revision, version, time_ns, data.get("result"), data.get("fault"), None, stopped)

    @classmethod
    def stored(cls, stored: StoredDiagnosis) -> Current:
        """Return a diagnosis that the store has."""
        return cls.published(stored.revision, stored.time_ns, stored.result)

    @property
    def bad_sets(self) -> tuple[tuple[str, ...], ...] | None:
        """What each diagnosis blames; None without a result."""
        if self.answer is not None:
            return self.answer.bad_sets
        if self.result is None:
            return None
        return tuple(tuple(diagnosis["bad"]) for diagnosis in self.result["diagnoses"])

    @property
    def healthy(self) -> bool:
        """OBS is what a healthy system would show; False without a result as well."""
        return healthy(self.bad_sets or ()) if self.answer is None else self.answer.healthy

    def says_the_same_as(self, before: Current | None) -> bool:
        """Return whether this is no news, whatever time it took."""
        if before is None or before.fault != self.fault or before.model_version != self.model_version:
            return False
        if before.expected_stopped != self.expected_stopped:
            return False
        if before.answer is not None and self.answer is not None:
            return before.answer.key == self.answer.key
        if before.result is None or self.result is None:
            return before.result is self.result
        return {**before.result, "elapsed_s": 0} == {**self.result, "elapsed_s": 0}

    def announce(self, robot: str, tx: Transaction) -> None:
        """Write it, with its event."""
        diagnoses.record(tx, robot, self.revision, self.event_data())

    def event_data(self) -> Encoded:
        """Return what table and event hold of it; equal answers have all but revision and time in common."""
        data = {
            "revision": self.revision,
            "model_version": self.model_version,
            "result": self.result,
            "fault": self.fault,
            "expected_stopped": list(self.expected_stopped),
        }
        if self.answer is None:
            return Encoded(data)
        return Encoded.around(
            data, f'{{"revision":{self.revision},', self._common(self.answer), f"{self.answer.took or ''}}}"
        )

    def _common(self, answer: Diagnosed) -> Common:
        of = (self.model_version, self.expected_stopped)
        common = answer.kept_as.get(of)
        if common is None:
            rest = to_json(
                {
                    "model_version": self.model_version,
                    "fault": self.fault,
                    "expected_stopped": list(self.expected_stopped),
                }
            )
            result = "null" if answer.took is None else answer.key
            common = answer.kept_as[of] = Common(f'{rest[1:-1]},"result":{result}')
        return common
