"""What is played for which options."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from robomend_demo.cast import tedusar, tedusar_with_spare
from robomend_demo.command import ALL, chosen
from robomend_demo.run import Wanted
from robomend_demo.scenarios import DEAD_LIDAR, HUNG_DEVICE, POWER_UP, SCENARIOS, SHUT_DOWN
from robomend_demo.screen import WHAT_HAPPENS


def test_without_a_word_the_papers_two_are_played_or_the_one_that_its_domain_can_do() -> None:
    assert chosen((), paper=False) == (POWER_UP, SHUT_DOWN)
    assert chosen((), paper=True) == (SHUT_DOWN,)


def test_scenarios_come_in_an_order_in_which_one_robot_can_have_them() -> None:
    assert chosen(("dead-lidar", "hung-device", "power-up"), paper=False) == (
        POWER_UP,
        HUNG_DEVICE,
        DEAD_LIDAR,
    )
    assert chosen((ALL, "shut-down"), paper=False) == tuple(SCENARIOS.values())


def test_what_the_papers_domain_cannot_repair_is_refused_by_name() -> None:
    assert chosen(("power-up",), paper=True) == (POWER_UP,)
    with pytest.raises(click.UsageError, match="cannot repair hung-device and dead-lidar"):
        chosen((ALL,), paper=True)


def test_the_robot_is_the_papers_unless_it_needs_a_spare() -> None:
    assert Wanted((POWER_UP, HUNG_DEVICE)).robot == tedusar()
    assert Wanted((POWER_UP, DEAD_LIDAR)).robot == tedusar_with_spare()
    paper = Wanted((SHUT_DOWN,), paper_domain=True).robot
    assert paper.model == tedusar().model
    assert paper.domain is not None
    assert paper.hold_s > 0


def test_every_scenario_says_what_happens_and_breaks_a_device_of_its_robot() -> None:
    assert {name: WHAT_HAPPENS[name] for name in SCENARIOS} == {
        name: one.happens for name, one in SCENARIOS.items()
    }
    for scenario in SCENARIOS.values():
        assert scenario.victim in Wanted((scenario,)).robot.model.hardware


def test_the_page_names_every_scenario() -> None:
    page = (Path(__file__).parents[2] / "docs" / "demo.md").read_text(encoding="utf-8")
    assert [name for name in SCENARIOS if f"`{name}`" not in page] == []
