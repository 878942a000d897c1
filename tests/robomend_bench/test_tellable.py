"""Which faults can be told is said by the healthy recording alone."""

from __future__ import annotations

import numpy as np
import pytest

from robomend_bench.batch.edited import longest_standstill, scarcest, why_not

STEADY = np.arange(0, 30, 0.1)
PAUSED = np.delete(STEADY, slice(100, 140))  # four seconds without a message
NONE = np.zeros(0)


@pytest.mark.parametrize("kind", ["dropped", "thinned"])
def test_what_comes_regularly_can_be_told_to_be_missing_and_what_pauses_by_itself_cannot(kind: str) -> None:
    assert why_not(kind, STEADY, NONE, 6.0) is None
    assert why_not(kind, PAUSED, NONE, 6.0) is not None


def test_a_fault_that_lasts_longer_than_any_pause_can_be_told() -> None:
    assert why_not("dropped", PAUSED, NONE, 60.0) is None


def test_half_of_the_messages_missing_by_themselves_is_as_few_as_that() -> None:
    halved = np.concatenate([STEADY[:150], STEADY[150::2]])
    assert scarcest(halved, 2.0) == pytest.approx(0.66, abs=0.1)  # against the usual part of all of them
    assert scarcest(STEADY, 2.0) > 0.9
    assert why_not("thinned", np.concatenate([STEADY[:250], STEADY[250::3]]), NONE, 6.0) is not None


def test_a_range_that_did_not_hold_by_itself_is_none() -> None:
    stands, walks = np.sin(np.arange(200.0)), 5 * np.sin(np.arange(200.0))
    assert why_not("ramped", STEADY, np.concatenate([stands, 1.2 * stands]), 6.0) is None
    assert why_not("ramped", STEADY, np.concatenate([stands, walks]), 6.0) == "its range was not seen"


def test_a_number_that_stands_still_by_itself_is_not_told_to_be_frozen() -> None:
    moves = np.arange(300.0) % 7
    stands = np.where((STEADY > 10) & (STEADY < 14), 3.0, moves)
    assert why_not("frozen", STEADY, moves, 6.0) is None
    assert why_not("frozen", STEADY, stands, 6.0) is not None
    assert why_not("frozen", STEADY, stands, 9.0) is None


def test_how_long_a_number_stands_still_is_from_its_first_message_to_its_last() -> None:
    times = np.array([0.0, 1.0, 3.0, 4.0, 9.0])
    assert longest_standstill(times, np.array([1.0, 1.0, 1.0, 2.0, 1.0])) == 3.0
    assert longest_standstill(times, np.array([1.0, 2.0, 3.0, 4.0, 4.0])) == 5.0
    assert longest_standstill(times, np.arange(5.0)) == 0.0


def test_of_a_topic_that_is_silent_by_itself_nothing_can_be_taken() -> None:
    assert why_not("dropped", STEADY, NONE, 6.0, 9.0) is None
    assert why_not("dropped", STEADY, NONE, 6.0, 5.0) == "50% of the usual messages are there by themselves"
