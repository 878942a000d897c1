"""The planning suite: seeded robots, and contenders that answer."""

from __future__ import annotations

import pytest

from robomend.errors import OptionRefused
from robomend_bench.running import run_suite
from robomend_bench.suite import Wish, find_suite


def test_every_contender_plans_the_papers_scenarios() -> None:
    suite = find_suite("plans")
    wish = Wish(mode="time", only=("tedusar",), timeout_s=300)
    (group,) = suite.groups(wish)
    for contender in suite.contenders("time"):
        ask = suite.prepare(contender, group, wish)
        assert [ask(question).shown for question in group.questions] == [12, 3], contender
    with pytest.raises(OptionRefused, match="no contender"):
        suite.prepare("graphplan", group, wish)


def test_mode_cost_compares_the_cost_of_plans_on_both_groups() -> None:
    wish = Wish(mode="cost", instances=2, timeout_s=300)
    run = run_suite(find_suite("plans"), wish, ("asp", "pyperplan"), repeats=1)
    assert {(sample.group, sample.bound) for sample in run.samples} == {
        (group, bound) for group in ("small-robots", "supplied-robots") for bound in (1.0, 1.1)
    }
    assert all(sample.cost for sample in run.samples)
    assert run.disagreements == ()
