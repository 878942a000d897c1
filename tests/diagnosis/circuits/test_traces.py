"""Conflicts by simulation: each is one, meets the diagnosis in one gate, and is minimal if it says so."""

from __future__ import annotations

from hypothesis import given
from pysat.solvers import Solver
from tests.diagnosis.netlists import Circuit, observed_circuits

from robomend.diagnosis.circuits.netlist import find_cones, recover
from robomend.diagnosis.circuits.traces import Traces
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.observed import ObservationReader
from robomend.diagnosis.result import Options
from robomend_client.literals import Literal


def found_for(made: Circuit, seen: frozenset[Literal], options: Options) -> tuple[int, int, int]:
    """Check what is found for each member of a diagnosis; count members, conflicts and minimal ones."""
    cnf = made.cnf
    netlist = recover(cnf)
    assert netlist is not None
    observed = ObservationReader(cnf).read(seen)
    sensors = frozenset(map(abs, observed.numbers))
    traces = Traces(netlist, find_cones(netlist, sensors).seen, sensors)
    engine = make_engine("sat", cnf)
    members = conflicts = minimal = 0
    with Solver("minisat22", bootstrap_with=cnf.clauses) as solver:
        for diagnosis in engine.diagnose(seen, options).diagnoses:
            bad = [cnf.health[name] for name in diagnosis.bad]
            rests = [[other for other in bad if other != one] for one in bad]
            walk = traces.walk(observed, rests)
            for lane, one in enumerate(bad):
                members += 1
                conflict = walk.conflict(lane)
                if conflict is None:
                    continue
                conflicts += 1
                assert set(conflict.components) & set(bad) == {one}
                assert observed.seen.issuperset(conflict.observations)
                assert not solver.solve([*conflict.components, *conflict.observations])
                if conflict.minimal:
                    minimal += 1
                    for spared in conflict.components:
                        left = [other for other in conflict.components if other != spared]
                        assert solver.solve([*left, *observed.numbers])
    engine.close()
    return members, conflicts, minimal


@given(observed_circuits())
def test_what_simulation_finds_is_a_conflict(asked: tuple[Circuit, frozenset[Literal]]) -> None:
    found_for(*asked, Options(limit=None, timeout_s=None, conflicts=False))
