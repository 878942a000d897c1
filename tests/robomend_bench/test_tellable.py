"""Which faults can be told is said by the healthy recording alone."""

from __future__ import annotations

import numpy as np
import pytest

from robomend_bench.batch.tellable import scarcest, why_not

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
    assert why_not("frozen", STEADY, NONE, 6.0) is None
