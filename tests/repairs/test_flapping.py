"""What comes and goes is a fault by itself, and told once."""

from __future__ import annotations

import random
from collections.abc import Collection
from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest

from robomend.planning.policy import Policy
from robomend.repairs.flapping import HELD_S, STEADY_S, TIMES, Flapping
from robomend.repairs.reasons import LAPSED_S, ReasonsToRepair
from robomend.store.records import Stop
from robomend_client.literals import Atom

LIDAR = frozenset({("lidar",), ("driver",)})
MAP = frozenset({("mapping",)})


def seen(*bad: tuple[str, ...], lapsed: Collection[Atom] = (), symptoms: Collection[Atom] = ()) -> Any:
    """Return a robot of which these are suspected."""
    sight = SimpleNamespace(
        lapsed_bad=lambda: tuple(lapsed), may_be_late_s=lambda atoms: 0.0, symptoms=lambda: symptoms
    )
    current = SimpleNamespace(healthy=not bad, bad_sets=bad, revision=1)
    config, system = SimpleNamespace(policy="auto"), SimpleNamespace(parts=object())
    return SimpleNamespace(current=current, head=1, config=config, system=system, sight=sight)


def begins(found: ReasonsToRepair, robot: Any) -> bool:
    """Whether a repair begins now."""
    return found.wait_s(robot, Policy(), Stop()) == 0.0


def test_for_the_same_suspects_nothing_is_begun_for_a_while_unless_it_lasts() -> None:
    found = Flapping()
    for n in range(TIMES):
        found.well_by_itself(LIDAR, float(n))
    assert found.wait_s(LIDAR, TIMES, 0.0) == STEADY_S
    assert found.wait_s(frozenset({("lidar", "mapping")}), TIMES, 0.0) == STEADY_S
    assert found.wait_s(MAP, TIMES, 0.0) == 0.0
    assert found.wait_s(LIDAR | MAP, TIMES, 0.0) == 0.0  # mapping alone may be it
    assert found.wait_s(LIDAR, TIMES + HELD_S, 0.0) == 0.0
    assert found.well_by_itself(LIDAR, TIMES + HELD_S) is None  # counted anew


def test_what_is_well_again_each_time_that_nothing_may_be_done_about_it_is_not_told_for_ever() -> None:
    found, begun = ReasonsToRepair(), 0
    for _ in range(3 * TIMES):
        if begins(found, seen(*LIDAR)):
            begun += 1  # and escalated, as the limit of its acts is reached
            found.gave_up(LIDAR, None, interlocked=False, untouched=True)
        assert not begins(found, seen(*LIDAR))
        begins(found, seen())  # well again
    assert begun == TIMES
    assert begins(found, seen(*MAP))

    found, begun = ReasonsToRepair(), 0
    for _ in range(3 * TIMES):
        begun += begins(found, seen(*LIDAR))
        found.gave_up(LIDAR, None, interlocked=False)  # something was done each time: see quarantine
        begins(found, seen())
    assert begun == 3 * TIMES


def test_what_was_given_up_on_and_only_not_heard_of_is_tried_again_more_and_more_rarely() -> None:
    now_s, scan = 1000.0, Atom("ok", ("scan",))

    found, begun = ReasonsToRepair(), list[float]()
    with patch("time.monotonic", lambda: now_s):
        while now_s < 1000.0 + 10 * LAPSED_S:
            if begins(found, seen(*LIDAR)):
                begun.append(now_s)
                found.gave_up(LIDAR, None, frozenset({scan}), interlocked=False)
            now_s += 1.0
            assert not begins(found, seen(lapsed=[scan]))  # its reporter is late, again
            now_s += 1.0
        assert [then - before for before, then in pairwise(begun)] == [2.0, 60.0, 120.0, 240.0]
        begins(found, seen())  # it was seen to be well
        assert begins(found, seen(*LIDAR))


RUNS, IMAGE, DEPTH = (Atom("running", ("left",)), Atom("ok", ("image",)), Atom("ok", ("depth",)))
HEARD_OF = (frozenset[Atom](), frozenset({DEPTH}), frozenset({RUNS, DEPTH}), frozenset({RUNS, IMAGE, DEPTH}))


@pytest.mark.parametrize("seed", range(20))
def test_what_is_heard_of_in_part_is_no_new_fault_whoever_else_may_be_blamed_for_that_part(seed: int) -> None:
    """One camera is down for ever; those who report it are starved, each when it likes."""
    now_s, then, rng = 1000.0, frozenset({RUNS, IMAGE, DEPTH}), random.Random(seed)
    heard = [(rng.choice(HEARD_OF), rng.choice([0.5, 1.0, 7.0])) for _ in range(200)]

    found, begun = ReasonsToRepair(), list[float]()
    with patch("time.monotonic", lambda: now_s):
        for known, for_s in [(then, 1.0), *heard]:
            bad = (("left",),) if RUNS in known else (("left",), ("merge",), ("right",)) if known else ()
            robot = seen(*bad, lapsed=then - known, symptoms=then)
            if begins(found, robot):
                begun.append(now_s)
                found.gave_up(frozenset(robot.current.bad_sets), None, then, interlocked=False)
            now_s += for_s
    # The first time at once, as by an agent that went away and came back.
    gaps = [after - before for before, after in pairwise(begun)]
    assert all(gap >= LAPSED_S * 2**n for n, gap in enumerate(gaps[1:]))


@pytest.mark.parametrize("jump_s", [-3600.0, 0.0, 3600.0])
def test_what_is_tried_again_after_a_while_is_so_whatever_the_computers_clock_does_meanwhile(
    jump_s: float,
) -> None:
    """As at a boot without a battery for its clock: NTP sets it a while later."""
    now_s, wall_s = 1000.0, 1e9
    robot = seen(*LIDAR)
    found = ReasonsToRepair()
    with patch("time.monotonic", lambda: now_s), patch("time.time_ns", lambda: round(wall_s * 1e9)):
        assert begins(found, robot)
        found.gave_up(LIDAR, round((wall_s + 120.0) * 1e9), interlocked=False, takes_up={"times": 1})
        now_s, wall_s = now_s + 110.0, wall_s + 110.0 + jump_s
        assert not begins(found, robot)
        now_s, wall_s = now_s + 10.1, wall_s + 10.1
        assert begins(found, robot)
        assert found.again == {"times": 1}
