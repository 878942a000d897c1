"""The planning suite: seeded robots, and contenders that answer."""

from __future__ import annotations

from typing import Any

import pytest

from robomend.errors import OptionRefused
from robomend.planning import planning
from robomend.planning.decomposition import Part
from robomend.planning.planning import EXACT_UP_TO, in_series
from robomend_bench.running import run_suite
from robomend_bench.suite import Wish, find_suite
from robomend_bench.suites.plans import broken, longest_chain, random_robot, some_bad, supplied_robot


def test_the_same_seed_gives_the_same_robot() -> None:
    assert random_robot(3, 50) == random_robot(3, 50)
    assert random_robot(3, 50) != random_robot(4, 50)
    assert some_bad(random_robot(3, 50), 2, 7) == some_bad(random_robot(3, 50), 2, 7)


def test_a_robot_has_as_many_components_as_asked_and_longer_chains_when_larger() -> None:
    small, large = random_robot(1, 40), random_robot(1, 400)
    assert len(small.components) == 40
    assert 1 < longest_chain(small) < longest_chain(large)
    assert len(broken(large, large.components)) > 200


def test_every_contender_plans_the_papers_scenarios() -> None:
    suite = find_suite("plans")
    wish = Wish(mode="time", only=("tedusar",), timeout_s=30)
    (group,) = suite.groups(wish)
    for contender in suite.contenders("time"):
        ask = suite.prepare(contender, group, wish)
        assert [ask(question).shown for question in group.questions] == [12, 3], contender
    with pytest.raises(OptionRefused, match="no contender"):
        suite.prepare("graphplan", group, wish)


def test_robots_with_a_supply_are_seeded_and_of_the_size_that_is_said() -> None:
    robots = [supplied_robot(seed) for seed in range(100)]
    assert supplied_robot(7) == robots[7] != robots[8]
    assert {len(robot.components) for robot in robots} == set(range(9, 15))
    assert all(sum("supply" in h.fed_by for h in robot.hardware.values()) >= 3 for robot in robots)


def test_robots_with_a_supply_are_planned_in_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    staged: list[int] = []

    def watched(part: Part, solve: Any) -> tuple[int, ...] | None:
        plan = in_series(part, solve)
        if plan is not None:
            staged.append(len(part.actions))
        return plan

    monkeypatch.setattr(planning, "in_series", watched)
    suite = find_suite("plans")
    wish = Wish(mode="cost", only=("supplied-robots",), timeout_s=60)
    (group,) = suite.groups(wish)
    assert len(group.questions) == 30
    ask = suite.prepare("asp", group, wish)
    planned = 0
    for question in group.questions:
        staged.clear()
        assert ask(question).complete, question.name
        assert all(actions > EXACT_UP_TO for actions in staged), question.name
        planned += bool(staged)
    assert planned >= 10  # the others have so little to do that it is planned at once


def test_mode_cost_compares_the_cost_of_plans_on_both_groups() -> None:
    wish = Wish(mode="cost", instances=2, timeout_s=60)
    run = run_suite(find_suite("plans"), wish, ("asp", "pyperplan"), repeats=1)
    assert {(sample.group, sample.bound) for sample in run.samples} == {
        (group, bound) for group in ("small-robots", "supplied-robots") for bound in (1.0, 1.1)
    }
    assert all(sample.cost for sample in run.samples)
    assert run.disagreements == ()
