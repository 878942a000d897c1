"""The exemplars of others: their systems by themselves, the rival's rules, and the service."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from robomend_bench.faults.exemplars import (
    Exemplar,
    Outcome,
    fly,
    play_sunset,
    sunset_table,
    told_as_the_rival,
)
from robomend_bench.faults.suave import MODES, MOTION, SEARCH
from robomend_bench.faults.sunset import Options, scenarios, with_rival
from robomend_bench.service.process import Served, served


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
