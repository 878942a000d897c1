"""What is awaited of a step: what somebody observes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.repairs.lidar_robot import ON, RUNNING, SCAN, Robot, setting

from robomend.repairs.looking import Looking
from robomend_client.literals import Atom, Literal

pytestmark = pytest.mark.anyio

WANTED = Literal(SCAN)


async def effect(robot: Robot, observed: set[Atom]) -> tuple[list[Literal], list[Literal]]:
    """Await ok(scan) where these atoms are on the robot's `observed` list; nothing moves meanwhile."""
    here = replace(setting(robot), observed=frozenset(observed))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    seen, missing = await Looking(here).effect([WANTED], 0.01)
    return list(seen), list(missing)


async def test_an_effect_on_the_observed_list_is_awaited_though_obs_never_held_it() -> None:
    robot = Robot(obs={ON: True, RUNNING: True})
    assert await effect(robot, {SCAN}) == ([], [WANTED])


async def test_an_effect_that_obs_holds_is_awaited_though_no_list_names_it() -> None:
    robot = Robot(obs={SCAN: False})
    assert await effect(robot, set()) == ([], [WANTED])
    robot.see(SCAN, True)
    assert await effect(robot, set()) == ([WANTED], [])


async def test_an_effect_that_nobody_observes_is_neither_seen_nor_missing() -> None:
    assert await effect(Robot(obs={}), {ON}) == ([], [])
