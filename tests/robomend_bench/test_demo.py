"""`robomend-bench demo`: which acts of a played scenario are needless, and what is told of them."""

from __future__ import annotations

from typing import Any

import pytest

from robomend_bench.demo import needless, report, sent

SHUT_DOWN = ["power_up(jaguar)", "stop_node(jaguar_node)", "start_node(jaguar_node)"]


def action(index: int, text: str, state: str, repair: str = "r-1") -> dict[str, Any]:
    return {"kind": "action", "repair": repair, "index": index, "text": text, "state": state}


def test_acts_are_those_that_were_sent_each_once_however_often_they_are_told() -> None:
    events = [
        {"kind": "diagnosis"},
        action(0, SHUT_DOWN[0], "running"),
        action(0, SHUT_DOWN[0], "running"),
        action(0, SHUT_DOWN[0], "done"),
        action(1, SHUT_DOWN[1], "already-there"),
        action(2, SHUT_DOWN[2], "running"),
        action(2, SHUT_DOWN[2], "failed"),
        action(3, SHUT_DOWN[2], "running"),
        action(0, SHUT_DOWN[0], "running", "r-2"),
        {"kind": "action", "id": "the agent's side of it", "state": "taken"},
    ]
    assert sent({"events": events}) == [SHUT_DOWN[0], SHUT_DOWN[2], SHUT_DOWN[2], SHUT_DOWN[0]]


@pytest.mark.parametrize(
    ("scenario", "acts", "found"),
    [
        ("shut-down", SHUT_DOWN, []),
        ("shut-down", [*SHUT_DOWN, *SHUT_DOWN[1:]], ["start_node(jaguar_node)", "stop_node(jaguar_node)"]),
        ("shut-down", [*SHUT_DOWN, "start_node(rviz)"], ["start_node(rviz)"]),
        ("power-up", ["power_up(hokuyo)", "start_node(rviz)"], []),
        (
            "power-up",
            ["start_node(rviz)", "stop_node(rviz)", "start_node(rviz)"],
            ["start_node(rviz)", "stop_node(rviz)"],
        ),
    ],
)
def test_needless_is_what_is_beyond_what_the_scenario_calls_for(
    scenario: str, acts: list[str], found: list[str]
) -> None:
    assert needless(scenario, acts) == found


def test_the_table_counts_runs_with_a_needless_act_and_names_the_acts() -> None:
    played = [
        ("shut-down", True, [], 1.0),
        ("shut-down", False, ["a", "b"], 3.0),
        ("power-up", True, [], 2.0),
    ]
    told = report(played, 4)
    assert told[0] == "`robomend demo` beside 4 busy loops"
    assert any(line.startswith("| shut-down | 2 | 1 | 1 (9–91%) |") for line in told)
    assert told[-1] == "\nneedless in shut-down: a, b"
