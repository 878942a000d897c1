"""What is awaited of a step: what somebody observes."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from unittest.mock import ANY

import pytest
from tests.repairs.lidar_robot import CNF, ON, RUNNING, SCAN, Robot, setting

from robomend.planning.prediction import Prediction, Theory
from robomend.repairs.looking import LONGER, LOOK_S, SOON_S, Looking
from robomend_client.literals import Atom, Literal

pytestmark = pytest.mark.anyio

WANTED = Literal(SCAN)


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


async def test_of_power_no_word_is_awaited_that_nobody_says_as_long_as_the_driver_is_mute() -> None:
    assert await effect(Robot(obs={ON: True, RUNNING: True}), {SCAN}, "power_up") == ([], [])
    assert await effect(Robot(obs={SCAN: False}), {SCAN}, "power_up") == ([], [WANTED])


async def test_an_effect_that_obs_holds_is_awaited_though_no_list_names_it() -> None:
    robot = Robot(obs={SCAN: False})
    assert await effect(robot, set()) == ([], [WANTED])
    robot.see(SCAN, True)
    assert await effect(robot, set()) == ([WANTED], [])


async def test_obs_is_looked_at_unasked_too_but_no_longer_than_the_time_out() -> None:
    waits: list[float] = []

    class Deaf(Robot):
        """OBS of which no change is told."""

        async def changed(self, revision: int, timeout_s: float) -> int:
            waits.append(timeout_s)
            if len(waits) == 2:
                self.obs[SCAN] = True
            await asyncio.sleep(0)
            return revision

    here = replace(setting(Deaf(obs={SCAN: False})), observed=frozenset({SCAN}))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    assert await Looking(here).effect("start_node", [WANTED], 30.0, 0) == ((WANTED,), (), ANY)
    assert waits == [LOOK_S, LOOK_S]
    waits.clear()
    here = replace(setting(Deaf(obs={SCAN: False})), observed=frozenset({SCAN}))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    await Looking(here).effect("start_node", [WANTED], LOOK_S / 5, 0)
    assert max(waits) <= LOOK_S / 5
    waits.clear()
    here = replace(setting(Deaf(obs={SCAN: False}, known_s=10.0)), observed=frozenset({SCAN}))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    await Looking(here).effect("start_node", [WANTED], 30.0, 0)
    assert waits == [SOON_S, SOON_S]  # how long it takes is known, and news that repeat wake nobody
    assert SOON_S < LOOK_S


async def test_an_effect_that_nobody_observes_is_neither_seen_nor_missing() -> None:
    assert await effect(Robot(obs={}), {ON}) == ([], [])


async def test_an_effect_is_given_up_before_the_time_out_where_earlier_starts_were_faster() -> None:
    here = replace(setting(Robot(obs={SCAN: False}, known_s=0.0)), observed=frozenset({SCAN}))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    seen, missing, within = await Looking(here).effect("start_node", [WANTED], 600.0, 0)
    assert (seen, missing) == ((), (WANTED,))
    assert within.endswith(LONGER)


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


async def test_what_rests_on_what_broke_is_awaited_no_longer() -> None:
    map_ = Atom("ok", ("map",))
    described = replace(CNF, atoms=(*CNF.atoms, map_), clauses=(*CNF.clauses, (-5, 6)), variables=6)
    well = {
        Atom(p, (c,))
        for p, c in [("on", "lidar"), ("good", "lidar"), ("running", "driver"), ("good", "driver")]
    }
    robot = Robot(obs={SCAN: True, map_: False})
    here = replace(setting(robot), prediction=Prediction(Theory(described), described.components, well))
    looking = Looking(here)

    async def breaks() -> Literal:
        broken = asyncio.ensure_future(looking.contradiction())
        await asyncio.sleep(0)  # it sees that scan is there
        robot.see(SCAN, False)
        return await broken

    async with asyncio.timeout(60):
        broken, awaited = await asyncio.gather(
            breaks(), looking.effect("start_node", [Literal(map_)], 600.0, 0)
        )
    assert broken == WANTED
    assert awaited[:2] == ((), ())


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
