"""`robomend-bench demo`: which acts of a played scenario are needless, and what is told of them."""

from __future__ import annotations

import pytest

from robomend_bench.demo import needless

SHUT_DOWN = ["power_up(jaguar)", "stop_node(jaguar_node)", "start_node(jaguar_node)"]


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
