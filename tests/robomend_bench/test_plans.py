"""The planning suite: seeded robots, and contenders that answer."""

from __future__ import annotations

import pytest

from robomend.errors import OptionRefused
from robomend_bench.plan_robots import broken, longest_chain, random_robot, some_bad
from robomend_bench.suite import Wish, find_suite


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
