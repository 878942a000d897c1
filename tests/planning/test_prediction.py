"""What OBS should show while a plan runs."""

from __future__ import annotations

from itertools import product

from hypothesis import given
from hypothesis import strategies as st

from robomend.model.cnf import HealthCnf, Rule
from robomend.planning.plan import Step
from robomend.planning.prediction import Prediction, Theory, observable
from robomend_client.literals import Atom, Literal, fails, holds

ON, RUNNING, SCAN = Atom("on", ("lidar",)), Atom("running", ("driver",)), Atom("ok", ("scan",))
MAP = Atom("ok", ("map",))


def cnf(*clauses: tuple[int, ...], atoms: tuple[Atom, ...] = (ON, RUNNING, SCAN)) -> HealthCnf:
    """Return a system of lidar (1) and driver (2), whose clauses speak of ¬AB (positive) and atoms from 3."""
    return HealthCnf(
        name="lidar robot",
        components=("lidar", "driver"),
        atoms=atoms,
        clauses=clauses,
        origins=tuple(0 for _ in clauses),
        rules=(Rule("1", "scheme 1"),),
        variables=2 + len(atoms),
    )


ROBOT = cnf((-1, 3), (-2, 4), (-1, -2, 5))
RESTART = Step(
    0,
    "start_node",
    ("driver",),
    3.0,
    (),
    (holds("stopped", "driver"),),
    (holds("running", "driver"), fails("stopped", "driver"), holds("good", "driver"), fails("bad", "driver")),
)


def facts(*texts: str) -> set[Atom]:
    return {Atom(text.split()[0], tuple(text.split()[1:])) for text in texts}


def test_a_topic_is_expected_once_all_that_it_rests_on_is_good() -> None:
    prediction = Prediction(
        Theory(ROBOT), ROBOT.components, facts("on lidar", "good lidar", "stopped driver", "bad driver")
    )
    assert prediction.expected() == {Literal(ON), -Literal(RUNNING)}
    prediction.begin(RESTART)
    assert prediction.expected() == {Literal(ON)}  # neither stopped for sure any more, nor running yet
    prediction.finish(RESTART)
    assert prediction.expected() == {Literal(ON), Literal(RUNNING), Literal(SCAN)}


def test_nothing_is_expected_that_follows_from_what_was_not_to_be_seen() -> None:
    described = cnf((-1, 3), (-2, 4), (-1, -2, 5), (-5, 6), atoms=(ON, RUNNING, SCAN, MAP))

    def expected(*failed: Atom) -> frozenset[Literal]:
        well = facts("on lidar", "good lidar", "running driver", "good driver")
        prediction = Prediction(Theory(described), described.components, well)
        assert Literal(MAP) in prediction.expected()
        for atom in failed:
            prediction.fail(Literal(atom))
        return prediction.expected()

    assert expected(MAP) == {Literal(ON), Literal(RUNNING), Literal(SCAN)}
    assert expected(SCAN) == {Literal(ON), Literal(RUNNING)}
    assert expected(RUNNING) == {Literal(ON), Literal(RUNNING)}  # the driver is not good


def test_the_paper_s_opposites_are_read_as_ours() -> None:
    assert observable(holds("not_on", "lidar")) == -Literal(ON)
    assert observable(fails("not_running", "driver")) == Literal(RUNNING)
    assert observable(Literal(SCAN)) == Literal(SCAN)


def test_rules_that_contradict_each_other_predict_nothing() -> None:
    theory = Theory(cnf((-1, 3), (-1, -3)))
    assert theory.derived(["lidar"]) == frozenset()


@given(st.lists(st.sets(st.integers(1, 5), min_size=1, max_size=3), max_size=6), st.data())
def test_what_is_derived_follows(variables: list[set[int]], data: st.DataObject) -> None:
    """Every derived literal holds in each model in which the components are healthy."""
    clauses = tuple(
        tuple(v if data.draw(st.booleans()) else -v for v in sorted(chosen)) for chosen in variables
    )
    system = cnf(*clauses)
    good = data.draw(st.sets(st.sampled_from(system.components)))
    derived = Theory(system).derived(good)
    for values in product((False, True), repeat=5):
        healthy = all(values[system.health[name] - 1] for name in good)
        model = all(any(values[abs(v) - 1] == (v > 0) for v in clause) for clause in clauses)
        if healthy and model:
            for literal in derived:
                assert values[2 + system.atoms.index(literal.atom)] == literal.positive
