"""Engines over time: deadlines and interrupts inside a solver call, other threads, solvers used again."""

from __future__ import annotations

import random
import threading

import pytest
from tests.diagnosis.netlists import circuit
from tests.diagnosis.systems import brute_force, model

from robomend.diagnosis import core_guided
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel
from robomend.model.cnf import Clause, HealthCnf
from robomend_client.literals import Literal

ALL = Options(limit=None, timeout_s=None)


def pigeons(holes: int) -> HealthCnf:
    """Return a model whose consistency check alone takes a solver for ever: holes + 1 pigeons, one keeper."""
    first = 2
    place = {(p, h): first + p * holes + h for p in range(holes + 1) for h in range(holes)}
    clauses: list[Clause] = [(-1, *(place[p, h] for h in range(holes))) for p in range(holes + 1)]
    clauses += [
        (-place[p, h], -place[q, h]) for h in range(holes) for p in range(holes + 1) for q in range(p)
    ]
    return model(1, clauses, atoms=(holes + 1) * holes)


@pytest.mark.parametrize("name", ["sat", "asp", "maxsat", "hs_dag", "cda_star"])
def test_a_deadline_ends_a_solver_call_that_would_not_end(name: str) -> None:
    engine = make_engine(name, pigeons(12))
    result = engine.diagnose([], Options(timeout_s=0.3))
    assert result.stopped_by == "time"
    assert not result.complete
    assert result.count is None
    engine.close()


@pytest.mark.parametrize("name", ["sat", "asp", "maxsat", "hs_dag", "cda_star"])
def test_an_interrupt_from_another_thread_ends_it(name: str) -> None:
    engine = make_engine(name, pigeons(12))
    threading.Timer(0.3, engine.interrupt).start()
    result = engine.diagnose([], Options(timeout_s=None))  # only the interrupt can end it
    assert result.stopped_by == "time"
    engine.close()


def test_an_interrupt_while_nothing_runs_does_not_spoil_the_next_call() -> None:
    engine = make_engine("sat", circuit("c17").cnf)
    engine.interrupt()
    assert engine.diagnose(circuit("c17").observe(1, 1)).complete


def test_after_a_deadline_the_engine_is_as_good_as_new() -> None:
    engine = make_engine("sat", circuit("c432").cnf)
    observations = circuit("c432").observe(3, 12)
    for timeout_s in (0.0, 0.0005, 0.002, 0.01):
        cut = engine.diagnose(observations, Options(timeout_s=timeout_s, limit=None, max_size=2))
        assert cut.complete or cut.stopped_by in ("time", "size")
    options = Options(minimal="cardinality", limit=None, timeout_s=None, conflicts=False)
    again = engine.diagnose(observations, options)
    assert (
        again.diagnoses == make_engine("sat", circuit("c432").cnf).diagnose(observations, options).diagnoses
    )


@pytest.mark.parametrize("name", ["sat", "asp", "maxsat", "hs_dag", "cda_star"])
def test_reuse_gives_the_same_as_a_fresh_engine(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core_guided, "RESET_SEARCHES", 10)  # so that the solver is built anew in between
    chance = random.Random(5)
    clauses: list[Clause] = []
    for _ in range(14):
        body = chance.sample(range(1, 6), chance.randint(1, 2))
        atoms = chance.sample(range(6, 10), chance.randint(1, 3))
        clauses.append((*(-c for c in body), *(a if chance.random() < 0.6 else -a for a in atoms)))
    cnf = model(5, clauses)
    engine = make_engine(name, cnf)
    for _ in range(30):
        seen = chance.sample(cnf.atoms, chance.randint(0, 4))
        observations = frozenset(Literal(atom, chance.random() < 0.5) for atom in seen)
        expected = brute_force(cnf, observations)
        if expected is None:
            with pytest.raises(ContradictoryModel):
                engine.diagnose(observations, ALL)
            continue
        assert {d.bad for d in engine.diagnose(observations, ALL).diagnoses} == expected
    engine.close()
