"""Our own plan check: what it lets pass, and what it names when it does not."""

from __future__ import annotations

from tests.planning.robots import TEDUSAR

from robomend.model.loops import strong_components
from robomend.planning.domain.loading import load_domain
from robomend.planning.grounding import Grounder
from robomend.planning.problem import repair_problem
from robomend.planning.validation import Named, replay, validate
from robomend_client.literals import fails

DOMAIN = load_domain()
PROBLEM = repair_problem(TEDUSAR, DOMAIN, [fails("on", "jaguar")], ["jaguar"])
GOOD: list[Named] = [
    ("power_up", ("jaguar",)),
    ("stop_node", ("jaguar_node",)),
    ("start_node", ("jaguar_node",)),
]


def both(plan: list[Named]) -> tuple[str, str]:
    grounder = Grounder(DOMAIN, PROBLEM)
    goal = [grounder.number(fact) for fact in PROBLEM.goal]
    return str(replay(grounder, plan, goal)[1]), str(validate(DOMAIN, PROBLEM, plan, PROBLEM.goal))


def test_the_failing_action_and_its_precondition_are_named() -> None:
    for text in both([GOOD[0], GOOD[2], GOOD[1]]):
        assert text == "step 1, start_node(jaguar_node): stopped(jaguar_node) does not hold before it"
    for text in both([GOOD[1], GOOD[0], GOOD[2]]):
        assert text == "step 0, stop_node(jaguar_node): bad(jaguar_node) does not hold before it"


def test_a_goal_that_is_missed_is_named() -> None:
    for text in both(GOOD[:1]):
        assert text == "after the last action good(jaguar_node) does not hold, which is a goal"


def test_what_cannot_be_switched_is_not_an_instance() -> None:
    grounder = Grounder(DOMAIN, PROBLEM)
    assert grounder.instances("power_up", ("imu",)) == ()
    assert grounder.instances("power_up", ("rviz",)) == ()
    flaw = replay(grounder, [("power_up", ("imu",))], [])[1]
    assert str(flaw) == "step 0, power_up(imu): a static precondition does not hold before it"


def test_the_initial_state_holds_exactly_one_of_each_pair() -> None:
    for name, kind in PROBLEM.objects.items():
        pairs = [("good", "bad"), ("on", "off") if kind == "hardware" else ("running", "stopped")]
        for one, other in pairs:
            assert ((one, name) in PROBLEM.initial) != ((other, name) in PROBLEM.initial)
    for fact in PROBLEM.initial:
        if fact[0] in ("off", "stopped"):
            assert ("bad", fact[1]) in PROBLEM.initial


def test_a_chain_of_ten_thousand_is_no_deeper_than_python() -> None:
    chain = {str(i): [str(i + 1)] for i in range(10_000)}
    assert len(set(strong_components({**chain, "10000": []}).values())) == 10_001
