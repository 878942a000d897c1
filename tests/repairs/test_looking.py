"""What is awaited of a step: what somebody observes."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from tests.repairs.lidar_robot import CNF, ON, RUNNING, SCAN, Robot, setting

from robomend.planning.prediction import Prediction, Theory
from robomend.repairs.looking import Looking
from robomend_client.literals import Atom, Literal

pytestmark = pytest.mark.anyio

WANTED = Literal(SCAN)
MAP = Atom("ok", ("map",))


async def effect(
    robot: Robot, observed: set[Atom], action: str = "start_node"
) -> tuple[list[Literal], list[Literal]]:
    """Await ok(scan) where these atoms are on the robot's `observed` list; nothing moves meanwhile."""
    here = replace(setting(robot), observed=frozenset(observed))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    seen, missing, _ = await Looking(here).effect(action, [WANTED], 0.01, 0)
    return list(seen), list(missing)


async def test_an_effect_on_the_observed_list_is_awaited_though_obs_never_held_it() -> None:
    robot = Robot(obs={ON: True, RUNNING: True})
    assert await effect(robot, {SCAN}) == ([], [WANTED])


async def test_of_power_nothing_is_awaited_that_was_said_before_the_cut_and_not_since() -> None:
    class SaidBefore(Robot):
        """What is said of the scan is from before the act."""

        def value(self, atom: Atom) -> bool | None:
            return None if atom == SCAN else super().value(atom)

    robot = SaidBefore(obs={ON: True, RUNNING: True, SCAN: True})
    assert await effect(robot, {SCAN}, "power_up") == ([], [])
    assert await effect(robot, {SCAN}) == ([], [WANTED])


async def test_once_one_observer_has_settled_on_no_the_others_are_not_waited_for_beyond_the_time_out() -> (
    None
):
    class Settling(Robot):
        """Who observes the map has to judge it anew."""

        def settling_s(self, atom: Atom) -> float:
            return 3600.0 if atom == MAP else 0.0

    both = frozenset({WANTED, Literal(MAP)})
    here = replace(setting(Settling(obs={SCAN: False})), observed=frozenset({SCAN, MAP}))
    here.prediction.expected = lambda: both  # type: ignore[method-assign]  # of no plan
    async with asyncio.timeout(60):
        _, missing, _ = await Looking(here).effect("start_node", both, 0.01, 0)
    assert set(missing) == both


async def test_an_effect_that_obs_holds_is_awaited_though_no_list_names_it() -> None:
    robot = Robot(obs={SCAN: False})
    assert await effect(robot, set()) == ([], [WANTED])
    robot.see(SCAN, True)
    assert await effect(robot, set()) == ([WANTED], [])


async def test_an_effect_that_nobody_observes_is_neither_seen_nor_missing() -> None:
    assert await effect(Robot(obs={}), {ON}) == ([], [])


async def test_an_effect_is_awaited_longer_than_the_time_out_where_its_observer_may_need_longer() -> None:
    class Slow(Robot):
        def settling_s(self, atom: Atom) -> float:
            return 600.0

        async def changed(self, revision: int, timeout_s: float) -> int:
            self.obs[SCAN] = True
            return revision + 1

    here = replace(setting(Slow(obs={SCAN: False})), observed=frozenset({SCAN}))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    assert (await Looking(here).effect("start_node", [WANTED], 0.0, 0))[:2] == ((WANTED,), ())


async def test_what_rests_on_an_effect_that_is_missing_is_awaited_no_longer() -> None:
    map_ = Atom("ok", ("map",))
    described = replace(CNF, atoms=(*CNF.atoms, map_), clauses=(*CNF.clauses, (-5, 6)), variables=6)
    well = {
        Atom(p, (c,))
        for p, c in [("on", "lidar"), ("good", "lidar"), ("running", "driver"), ("good", "driver")]
    }
    here = replace(
        setting(Robot(obs={SCAN: False, map_: False})),
        prediction=Prediction(Theory(described), described.components, well),
    )
    looking = Looking(here)
    async with asyncio.timeout(60):
        first, second = await asyncio.gather(
            looking.effect("start_node", [WANTED], 0.01, 0),
            looking.effect("start_node", [Literal(map_)], 600.0, 0),
        )
    assert first[:2] == ((), (WANTED,))
    assert second[:2] == ((), ())  # it is no longer missing, nor was it seen


async def test_what_the_plan_was_made_on_and_is_so_no_longer_is_told_and_not_built_upon() -> None:
    well = {
        Atom(p, (c,))
        for p, c in [("on", "lidar"), ("good", "lidar"), ("running", "driver"), ("good", "driver")]
    }
    robot = Robot(obs={ON: True, RUNNING: False, SCAN: False})  # it ended while it was planned
    here = replace(setting(robot), prediction=Prediction(Theory(CNF), CNF.components, well))
    looking = Looking(here)
    async with asyncio.timeout(60):
        broken, awaited = await asyncio.gather(
            looking.contradiction(), looking.effect("start_node", [WANTED], 600.0, 0)
        )
    assert broken == Literal(RUNNING)
    assert awaited[:2] == ((), ())
