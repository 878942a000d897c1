"""Observations in the solver's numbers."""

from __future__ import annotations

import pytest
from tests.diagnosis.systems import model

from robomend.diagnosis.observed import KEPT_UNUSED, ObservationReader
from robomend.errors import ContradictoryModel
from robomend_client.literals import fails, holds

CNF = model(1, [(-1, 2)], atoms=3)


def test_what_no_rule_mentions_is_told_once_and_refused_where_it_clashes() -> None:
    reader = ObservationReader(CNF)
    stranger = holds("ok", "stranger")
    for _ in range(2):  # new, then met before
        observed = reader.read([stranger, fails("ok", "a2"), stranger])
        assert observed.unused == (stranger,)
        assert observed.numbers == (-3,)
        assert observed.seen == {-3}
        with pytest.raises(ContradictoryModel):
            reader.read([stranger, fails("ok", "a2"), -stranger])


def test_strangers_do_not_fill_the_memory() -> None:
    reader = ObservationReader(CNF)
    reader.read([holds("ok", "a1"), *(holds("ok", f"stranger{number}") for number in range(3 * KEPT_UNUSED))])
    assert reader.read([holds("ok", "a1"), fails("ok", "a2")]).numbers == (2, -3)
    assert len(reader.known) < 2 * KEPT_UNUSED
