"""Goals of an action server: what was aborted is a fault, what was cancelled is none."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from tests.clients.observers.driving import values

from robomend_client.observers import Change, Driver, ns
from robomend_client.observers.goals import GoalRules, GoalsObserver, suggested

T0 = 1_700_000_000
ROS1, ROS2 = "dock/status:status_list[-64:]", "dock/_action/status:status_list[-64:]"


def new(name: int, status: int, given_s: float = T0) -> dict[str, Any]:
    stamp = {"sec": int(given_s), "nanosec": 0}
    return {"goal_info": {"goal_id": {"uuid": [name] * 16}, "stamp": stamp}, "status": status}


def old(name: str, status: int, text: str = "", given_s: float = T0) -> dict[str, Any]:
    return {
        "goal_id": {"id": name, "stamp": {"sec": int(given_s), "nanosec": 0}},
        "status": status,
        "text": text,
    }


def fed(
    told: Iterable[tuple[float, Any]], rules: GoalRules | None = None, source: str = ROS2
) -> tuple[Driver, list[Change]]:
    driver = Driver([GoalsObserver("ok(goals,dock)", rules=rules)], ns(T0))
    changes: list[Change] = []
    for at_s, goals in told:
        now_ns = ns(T0 + at_s)
        changes += driver.advance(now_ns)
        changes += driver.sample(source, now_ns, goals, now_ns)
    return driver, changes


def reading(driver: Driver) -> Any:
    (verdict,) = driver.standing()
    return verdict.reading


def test_a_server_that_nobody_asks_is_well_once_it_was_looked_for_long_enough() -> None:
    driver, changes = fed([], GoalRules(hold_s=20))
    assert values([*changes, *driver.advance(ns(T0 + 19.9))]) == []
    assert values(driver.advance(ns(T0 + 20.1))) == ["ok(goals,dock)"]


@pytest.mark.parametrize("status", [1, 2, 3, 5])
def test_a_goal_that_goes_on_or_is_cancelled_is_neither_fault_nor_recovery(status: int) -> None:
    assert values(fed([(1, [new(1, status)])])[1]) == []
    assert values(fed([(1, [new(1, 6)]), (2, [new(2, status)])])[1]) == ["not ok(goals,dock)"]


def test_actionlib_has_other_numbers_and_says_why() -> None:
    driver = Driver([GoalsObserver("ok(goals,dock)", rules=GoalRules(status="status"))], ns(T0))
    for at_s, goal, value in (
        (1, old("a", 1), None),
        (2, old("a", 3), "ok(goals,dock)"),
        (3, old("b", 2), "ok(goals,dock)"),  # preempted
        (4, old("c", 8), "ok(goals,dock)"),  # recalled
        (5, old("d", 4, "no valid plan"), "not ok(goals,dock)"),
        (6, old("e", 5, "asleep"), "not ok(goals,dock)"),
    ):
        driver.sample(ROS1, ns(T0 + at_s), [goal], ns(T0 + at_s))
        assert [str(one.literal) for one in driver.standing()] == ([value] if value else [])
    assert str(reading(driver)) == "2 goals rejected in a row: asleep"


def test_what_was_over_before_anybody_looked_is_no_fault_now() -> None:
    before, just_now = new(1, 6, T0 - 3600), new(2, 6, T0 - 5)
    assert values(fed([(1, [before])])[1]) == []
    assert values(fed([(1, [before, just_now])])[1]) == ["not ok(goals,dock)"]


def test_so_many_in_a_row_may_be_asked_for_and_one_that_succeeds_ends_the_row() -> None:
    rules = GoalRules(in_a_row=2)
    assert values(fed([(1, [new(1, 6)])], rules)[1]) == []
    assert values(fed([(1, [new(1, 6)]), (2, [new(2, 4)]), (3, [new(3, 6)])], rules)[1]) == ["ok(goals,dock)"]
    driver, changes = fed([(1, [new(1, 6)]), (2, [new(2, 6)])], rules)
    assert values(changes) == ["not ok(goals,dock)"]
    assert str(reading(driver)) == "2 goals aborted in a row, 2 in a row are too many"


@pytest.mark.parametrize(
    "value", [3, "x", [3], [{}], [{"goal_id": {"id": "a"}, "status": "x"}], [{"goal_info": 1}]]
)
def test_what_is_no_list_of_goals_makes_it_unknown_and_is_told_once(value: object) -> None:
    driver, _ = fed([(1, [new(1, 6)])])
    now_ns = ns(T0 + 2)
    assert [one.value for one in driver.sample(ROS2, now_ns, value, now_ns)] == [None]
    assert [what for what, _ in driver.problems.counts] == ["kind"]


def test_topics_of_action_servers_suggest_it() -> None:
    assert suggested("/a/dock/_action/status", "action_msgs/GoalStatusArray") == {
        "ok(goals,a/dock)": {"kind": "goals", "action": "a/dock"}
    }
    assert suggested("/dock/status", "actionlib_msgs/GoalStatusArray") == {
        "ok(goals,dock)": {"kind": "goals", "action": "dock", "preset": "ros1"}
    }
    assert suggested("/dock/status", "std_msgs/String") == {}


def test_a_while_in_which_nobody_looked_undoes_nothing_that_has_happened() -> None:
    driver, _ = fed([(1, [new(1, 6)])], GoalRules(in_a_row=2))
    driver.lapse(ns(T0 + 9))
    now_ns = ns(T0 + 10)
    found = driver.sample(ROS2, now_ns, [new(1, 6), new(2, 6)], now_ns)
    assert values(found) == ["not ok(goals,dock)"]
