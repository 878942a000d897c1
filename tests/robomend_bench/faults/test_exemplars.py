"""The exemplars of others: their systems by themselves, the rival's rules, and the service."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from robomend_bench.faults.condition import Act
from robomend_bench.faults.exemplars import (
    Exemplar,
    Outcome,
    fly,
    play_sunset,
    sunset_table,
    told_as_the_rival,
)
from robomend_bench.faults.suave import FAILS_S, MODES, MOTION, SEARCH, Suave
from robomend_bench.faults.sunset import ACTS, Options, Sunset, scenarios, with_rival
from robomend_bench.service.process import Served, served


def done(triple: tuple[str, str, str], *acts: str) -> Sunset:
    """Return a system that had a scenario, after these acts, each left its time."""
    system = Sunset()
    system.advance(2.0)
    system.plant(triple)
    by_text = {str(act): act for act in ACTS}
    for act in acts:
        system.advance(system.now_s + system.begin(by_text[act]) + 1.0)
    return system


def judged(system: Sunset) -> list[str]:
    return ["wrong" if one.wrong else "needless" if one.needless else "" for one in system.strategies]


def test_a_restart_ends_a_drop_and_a_redeployment_a_hard_one() -> None:
    soft = done(("shift", "segmentation", "drop"), "autofocus(lens)", "reactivate(segmentation)")
    assert soft.wrong == {"shift"}
    hard = done(("shift", "segmentation", "hard"), "reactivate(segmentation)", "redeploy(segmentation)")
    assert hard.wrong == {"shift", "unfocused"}
    assert judged(hard) == ["needless", ""]
    redeployed = done(("shift", "segmentation", "drop"), "redeploy(segmentation)")
    assert judged(redeployed) == ["needless"]
    assert redeployed.strategies[0].redeployed


def test_a_dark_picture_is_enhanced_and_a_shifted_one_recalibrated() -> None:
    dark = done(("dark", "camera", "drop"), "recalibrate(calibration)", "show(enhanced)")
    assert judged(dark) == ["wrong", ""]
    shifted = done(("shift", "segmentation", "drop"), "recalibrate(calibration)", "show(enhanced)")
    assert judged(shifted) == ["", "wrong"]


def test_the_restart_of_a_camera_ends_the_dark_which_ends_by_itself_too() -> None:
    system = done(("dark", "camera", "drop"), "reactivate(camera)", "autofocus(lens)")
    assert system.wrong == frozenset()
    assert system.clear_s is not None
    left = done(("dark", "segmentation", "drop"))
    left.advance(left.now_s + 25.0)
    assert left.wrong == {"drop segmentation", "unfocused"}


@pytest.mark.parametrize(
    ("options", "figures"),
    [(Options(), "3.82 | 1.94 | 1.34 | 1.62"), (Options(True, True, True), "3.54 | 0.72 | 0.32 | 0.00")],
)
def test_the_rival_does_what_was_measured_of_it(options: Options, figures: str) -> None:
    triples = scenarios()
    outcomes = [Outcome.of(*each) for each in zip(triples, with_rival(triples, options), strict=True)]
    *_, row = sunset_table({"it": outcomes})
    assert row.startswith(f"| it | 50 | {figures} |")
    assert "never" not in row


def test_suave_flies_at_the_altitude_that_is_expected_or_that_is_counted() -> None:
    system = Suave()
    system.advance(1.0)
    system.start()
    for tick in range(1, 101):
        system.advance(1.0 + tick / 10)
    assert system.wrong_s == pytest.approx(10.0)
    assert system.expected == "fd_spiral_high"
    system.begin(Act("change_mode", (SEARCH, "fd_spiral_high")))
    system.advance(11.5)
    assert system.wrong_s == pytest.approx(10.0)
    system.messages.clear()
    system.advance(1.0 + FAILS_S)
    assert [m for m in system.messages if "c_thruster_1" in str(m)]
    system.begin(Act("change_mode", (MOTION, "fd_recover_thrusters")))
    system.advance(1.0 + FAILS_S + 6.0)
    assert system.recovered


@pytest.fixture(scope="module")
def service() -> Iterator[Served]:
    with served() as running:
        yield running


def test_the_service_has_a_scenario_of_sunset_with_what_it_is_told(service: Served, tmp_path: Path) -> None:
    triple = ("shift", "segmentation", "drop")
    for exemplar in (Exemplar.read("sunset"), told_as_the_rival()):
        (outcome,) = asyncio.run(play_sunset(service.url, tmp_path, exemplar, [triple], 1))
        assert outcome.clear_s is not None, "\n".join(outcome.lines())
        assert {str(one.act) for one in outcome.strategies} >= {
            "autofocus(lens)",
            "reactivate(segmentation)",
            "recalibrate(calibration)",
        }


def test_the_service_flies_suave_as_high_as_it_sees_and_recovers_its_thruster(
    service: Served, tmp_path: Path
) -> None:
    flight = asyncio.run(fly(service.url, tmp_path, speed=4.0))
    assert flight.recovery_s is not None
    assert [mode for mode in flight.asked if mode in MODES[MOTION]] == [
        "fd_recover_thrusters",
        "fd_all_thrusters",
    ]
    assert {mode for mode in flight.asked if mode in MODES[SEARCH]} == {*MODES[SEARCH]}
    assert flight.left_alone == ()
