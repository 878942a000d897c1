"""The search of Livingstone: modes are assigned one by one, and no state is met twice."""

from __future__ import annotations

from tests.diagnosis.systems import model
from tests.diagnosis.test_modes import REVERSED, STUCK, motor

from robomend.diagnosis.cda_star import CdaStarEngine, _Search
from robomend.diagnosis.observed import NOTHING_SUPPOSED
from robomend.diagnosis.oracle import Deadline
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import SearchState
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal


def search_of(cnf: HealthCnf) -> tuple[CdaStarEngine, _Search]:
    """Return a search for which the first atom is false."""
    engine = CdaStarEngine(cnf)
    observed = engine._reader.read([Literal(cnf.atoms[0], False)])
    return engine, _Search(engine, observed, NOTHING_SUPPOSED, Options())


def test_the_modes_of_what_is_blamed_are_tried_one_by_one() -> None:
    engine, search = search_of(motor())
    root = search.cheapest()
    assert root is not None
    oracle = engine._consistency.oracle
    assert not oracle.sat(search.assumptions(root))
    search.learn(oracle.core() or (), SearchState(1, Deadline()))
    assert search.expand(root)
    tried = []
    while (child := search.cheapest()) is not None:
        tried.append({STUCK, REVERSED} & set(search.assumptions(child)))
    assert tried == [{STUCK}, {REVERSED}]
    engine.close()


def test_no_state_is_met_twice() -> None:
    engine, search = search_of(model(3, [(-1, -2, 4), (-1, -3, 4), (-2, -3, 4)]))
    oracle, met = engine._consistency.oracle, []
    while (node := search.cheapest()) is not None:
        if search.expand(node):
            continue
        if oracle.sat(search.assumptions(node)):
            met.append(node.abnormal)
        else:
            search.learn(oracle.core() or (), SearchState(1, Deadline()))
            search.expand(node)
    assert sorted(met) == [0b011, 0b101, 0b110]
    engine.close()
