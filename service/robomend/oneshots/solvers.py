"""Diagnoses in worker processes: the engine of a model stays warm where it was last used.

The compiled model travels only when a worker does not have it yet. A worker that breaks a deadline is
killed and its engines with it; the next call sends the model again.

Isolability is the same JSON from `robomend model check --isolability` and over HTTP.
"""

from __future__ import annotations

import json
import pickle
import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.isolability.analysis import Ambiguity, DoubleFaults, Isolability, isolability
from robomend.diagnosis.isolability.words import group_words, sentences, suggestions, undetectable_words
from robomend.diagnosis.probes import Prober, ProbeResult
from robomend.diagnosis.result import DiagnosisResult, Engine, Options
from robomend.errors import RobomendError
from robomend.model.cnf import HealthCnf
from robomend.model.packed import opened
from robomend.model.system import System
from robomend.oneshots.result_json import quoted_names, result_text
from robomend.oneshots.warm_model import PackedQuestion, ask_engine
from robomend.planning.drill import DIAGNOSIS_S, MOST_FAULTS, PlantableFault, drill_plan
from robomend.workers.pool import WorkerPool
from robomend_client.literals import Atom, Literal

MOST_IN_MATRIX = 500
"""Faults of a matrix that is written; a larger one is left out (null)."""

Words = Callable[[Ambiguity, System], Iterator[str]]


def isolability_json(found: Isolability, system: System) -> dict[str, Any]:
    """Return what can be detected and told apart, what would split the rest, and all of it in words."""
    return {
        "observed": [str(atom) for atom in found.observed],
        "unused": [str(atom) for atom in found.unused],
        "faults": [
            {"components": list(fault), "detectable": detectable}
            for fault, detectable in zip(found.faults, found.detectable, strict=True)
        ],
        "matrix": list(found.matrix) if len(found.matrix) <= MOST_IN_MATRIX else None,
        "groups": [_group(group, system, group_words) for group in found.ambiguities],
        "undetectable": [_group(group, system, undetectable_words) for group in found.undetectable],
        "double": None if found.double_faults is None else _double(found.double_faults, system),
        "exact_by": found.exact_by,
        "complete": found.complete,
        "elapsed_s": round(found.elapsed_s, 6),
        "text": sentences(found, system),
    }


def _group(group: Ambiguity, system: System, words: Words) -> dict[str, Any]:
    further = group.further
    return {
        "faults": [list(fault) for fault in group.faults],
        "rivals": [list(fault) for fault in group.rivals],
        "further": None
        if further is None
        else {
            "atoms": [str(atom) for atom in further.atoms],
            "cost_s": further.cost_s,
            "left": [{"fault": list(fault), "rival": list(rival)} for fault, rival in further.left],
            "all_looked_at": group.all_looked_at,
        },
        "suggestions": [{"add": one.add, "watch": str(one.watch)} for one in suggestions(group, system)],
        "text": "\n".join(words(group, system)),
    }


def _double(doubles: DoubleFaults, system: System) -> dict[str, Any]:
    return {
        "faults": [
            {"components": list(fault), "detectable": detectable}
            for fault, detectable in zip(doubles.faults, doubles.detectable, strict=True)
        ],
        "groups": [_group(group, system, group_words) for group in doubles.ambiguities],
        "complete": doubles.complete,
    }


KEPT = 4
"""Engines kept warm in each worker; a monstrous one takes hundreds of megabytes."""

MEMORY_BYTES = 4 << 30
"""Address space of a worker: a model that needs more ends its worker, not the computer."""

SEND_S = 5.0
"""What a deadline allows besides the search: the model's way to the worker, and its compilation there."""


ISOLABILITY_S = 5.0
"""What comparing faults may take besides its budget: its answer has a place for each pair."""


class SolverWorkers:
    """See the module. Thread-safe."""

    def __init__(self, size: int, queue_limit: int) -> None:
        self.pool = WorkerPool(
            "solver", size=size, spare=0, warm=warm, memory_bytes=MEMORY_BYTES, queue_limit=queue_limit
        )

    async def diagnose(
        self,
        key: str,
        engine: str,
        cnf: HealthCnf,
        literals: frozenset[Literal],
        options: Options,
        deadline_s: float,
    ) -> DiagnosisResult:
        """Diagnose in a worker.

        Raises:
            WorkerTimeout, WorkerDied, WorkersBusy: see robomend.workers.pool.
        """
        try:
            return await self.pool.run(
                diagnose, (key, engine), None, literals, options, timeout_s=deadline_s + SEND_S
            )
        except EngineMissing:
            return await self.pool.run(
                diagnose, (key, engine), cnf, literals, options, timeout_s=deadline_s + SEND_S
            )

    async def answer(self, engine: str, asked: PackedQuestion, deadline_s: float) -> bytes:
        """Diagnose in a worker what a reader has packed; return the result as JSON text."""
        return await self.pool.run(answer, engine, asked, timeout_s=deadline_s + SEND_S)

    async def probes(
        self,
        key: str,
        engine: str,
        cnf: HealthCnf,
        literals: frozenset[Literal],
        options: Options,
        limit: int,
        deadline_s: float,
    ) -> ProbeResult:
        """Diagnose and look for the observations worth making next,
        in a worker; raises as `diagnose` does.
        """
        return await self.pool.run(
            find_probes, (key, engine), cnf, literals, options, limit, timeout_s=deadline_s + SEND_S
        )

    async def isolability(
        self, system: System, observed: Collection[Atom] | None, double: bool, timeout_s: float
    ) -> str:
        """Compare all faults with all, in a worker, and return the JSON; raises as `diagnose` does."""
        deadline_s = timeout_s + ISOLABILITY_S + SEND_S
        return await self.pool.run(
            find_isolability, system, observed, double, timeout_s, timeout_s=deadline_s
        )

    async def drill_plan(
        self, system: System, observed: Collection[Atom], options: Mapping[str, Any], timeout_s: float
    ) -> tuple[list[PlantableFault], bool]:
        """Say what each fault that could be planted would show, in a worker; raises as `diagnose` does."""
        deadline_s = timeout_s + DIAGNOSIS_S + SEND_S
        return await self.pool.run(
            find_drill_plan, system, observed, options, timeout_s, timeout_s=deadline_s
        )

    async def close(self) -> None:
        """Kill the workers."""
        await self.pool.aclose()


class EngineMissing(RobomendError):
    """The worker does not have this model's engine: send the model. Never leaves this module."""

    code = "engine-missing"


_warm: OrderedDict[tuple[str, str], tuple[Engine, HealthCnf]] = OrderedDict()
"""Of a worker process."""


def warm() -> None:
    """Import what the first call needs."""
    make_engine("sat", HealthCnf("warm", ("c",), (), (), (), (), 1)).close()


def diagnose(
    key: tuple[str, str], cnf: HealthCnf | None, literals: frozenset[Literal], options: Options
) -> DiagnosisResult:
    """Answer one question; runs in a worker process."""
    if key not in _warm:
        if cnf is None:
            raise EngineMissing(key[0])
        while len(_warm) >= KEPT:
            _warm.popitem(last=False)[1][0].close()
        whole = opened(cnf)
        _warm[key] = make_engine(key[1], whole), whole
    _warm.move_to_end(key)
    return ask_engine(*_warm[key], literals, options)


def answer(engine: str, asked: PackedQuestion) -> bytes:
    """Answer one question as JSON text; runs in a worker process."""
    key = asked.version, engine
    cnf = None if key in _warm else pickle.loads(asked.model)
    result = diagnose(key, cnf, pickle.loads(asked.literals), asked.options)
    return result_text(result, quoted_names(result.components)).encode()


def find_isolability(
    system: System, observed: Collection[Atom] | None, double: bool, timeout_s: float
) -> str:
    """Compare all faults with all; runs in a worker process, as does making its JSON, which is long."""
    found = isolability(opened(system.cnf), observed, double=double, timeout_s=timeout_s)
    return json.dumps(isolability_json(found, system), ensure_ascii=False)


def find_drill_plan(
    system: System, observed: Collection[Atom], options: Mapping[str, Any], timeout_s: float
) -> tuple[list[PlantableFault], bool]:
    """Say what each fault that could be planted would show, and whether these are all; runs in a worker."""
    end_s = time.monotonic() + timeout_s
    found: list[PlantableFault] = []
    assert system.parts is not None
    for fault in drill_plan(system, system.parts, observed, **options):
        if len(found) == MOST_FAULTS or time.monotonic() > end_s:
            return found, False
        found.append(fault)
    return found, True


def find_probes(
    key: tuple[str, str], cnf: HealthCnf, literals: frozenset[Literal], options: Options, limit: int
) -> ProbeResult:
    """Answer which observations are worth making; runs in a worker process."""
    result = diagnose(key, cnf, literals, options)
    prober = Prober(opened(cnf))
    try:
        return prober.probes(sorted(literals), result, limit=limit, timeout_s=options.timeout_s)
    finally:
        prober.close()
