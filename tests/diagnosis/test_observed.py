"""Observations in the solver's numbers."""

from __future__ import annotations

import pytest
from tests.diagnosis.systems import model

from robomend.diagnosis.observed import ObservationReader
from robomend.errors import ContradictoryModel
from robomend_client.literals import fails, holds

CNF = model(1, [(-1, 2)], atoms=3)


def test_what_is_seen_twice_counts_once_and_what_fails_is_known() -> None:
    observed = ObservationReader(CNF).read([fails("ok", "a2"), holds("ok", "a1"), fails("ok", "a2")])
    assert observed.numbers == (-3, 2)
    assert list(map(CNF.literal_of, observed.numbers)) == [fails("ok", "a2"), holds("ok", "a1")]
    assert observed.failed == (-3,)


def test_a_literal_and_its_opposite_are_refused() -> None:
    with pytest.raises(ContradictoryModel):
        ObservationReader(CNF).read([fails("ok", "a2"), holds("ok", "a1"), holds("ok", "a2")])
