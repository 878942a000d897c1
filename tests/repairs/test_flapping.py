"""What comes and goes is a fault by itself, and told once."""

from __future__ import annotations

from robomend.repairs.flapping import HELD_S, STEADY_S, TIMES, WITHIN_S, Flapping

LIDAR = frozenset({("lidar",), ("driver",)})
MAP = frozenset({("mapping",)})


def test_what_was_well_by_itself_often_within_a_minute_is_told_with_its_suspects() -> None:
    found = Flapping()
    assert [found.well_by_itself(LIDAR, 10.0 + n) for n in range(TIMES - 1)] == [None] * (TIMES - 1)
    told = found.well_by_itself(MAP, 20.0)
    assert told is not None
    assert told.startswith(f"it comes and goes: {TIMES} times within 10 s ")
    assert "suspects: driver, lidar, mapping. " in told


def test_what_seldom_comes_and_goes_is_not_told() -> None:
    found = Flapping()
    assert not any(found.well_by_itself(LIDAR, n * WITHIN_S / (TIMES - 2)) for n in range(50))
    assert found.hold_s(LIDAR, 0.0) == 0.0


def test_for_the_same_suspects_nothing_is_begun_for_a_while_unless_it_lasts() -> None:
    found = Flapping()
    for n in range(TIMES):
        found.well_by_itself(LIDAR, float(n))
    assert found.hold_s(LIDAR, TIMES) == STEADY_S
    assert found.hold_s(frozenset({("lidar", "mapping")}), TIMES) == STEADY_S
    assert found.hold_s(MAP, TIMES) == 0.0
    assert found.hold_s(LIDAR | MAP, TIMES) == 0.0  # mapping alone may be it
    assert found.hold_s(LIDAR, TIMES + HELD_S) == 0.0
    assert found.well_by_itself(LIDAR, TIMES + HELD_S) is None  # counted anew
