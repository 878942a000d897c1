"""What is evidence after an act, and what is not."""

from __future__ import annotations

import pytest

from robomend.entry import Entry
from robomend.observations.pending import GUARD_NS, Act, Confirmed, Unconfirmed
from robomend_client.literals import Atom, Literal

SCAN, MAP = Atom("ok", ("scan",)), Atom("ok", ("map",))
ACT = Act(7, 1000 * 10**9)


def said(
    positive: bool = True, *, since: int | None = None, settled: int | None = None, lives: bool = True
) -> Entry:
    expires = 2000 * 10**9 if lives else None
    return Entry(Literal(SCAN, positive), "general", 1001 * 10**9, expires, since, None, settled)


def after_act() -> Unconfirmed:
    unconfirmed = Unconfirmed()
    unconfirmed.touch([SCAN, MAP], ACT)
    return unconfirmed


@pytest.mark.parametrize("positive", [True, False])
def test_evidence_from_before_the_answer_confirms_nothing_of_either_sign(positive: bool) -> None:
    unconfirmed = after_act()
    assert not unconfirmed.hear([said(positive, since=ACT.from_ns)])
    assert not unconfirmed.hear([said(positive, since=ACT.from_ns + GUARD_NS)])
    assert not unconfirmed.hear([said(positive, since=None)])
    assert SCAN in unconfirmed


def test_evidence_from_after_the_answer_confirms_its_atom_alone() -> None:
    unconfirmed = after_act()
    assert unconfirmed.hear([said(since=ACT.from_ns + GUARD_NS + 1)])
    assert SCAN not in unconfirmed
    assert MAP in unconfirmed


def test_an_answer_to_settle_confirms_whatever_the_clocks_say() -> None:
    unconfirmed = after_act()
    assert not unconfirmed.hear([said(since=1, settled=6)])
    assert unconfirmed.hear([said(since=1, settled=7)])
    unconfirmed = after_act()
    assert unconfirmed.hear([said(False, settled=8)])


def test_once_confirmed_it_stays_so_until_the_next_act() -> None:
    unconfirmed = after_act()
    unconfirmed.hear([said(settled=7)])
    unconfirmed.hear([said(since=1)])  # a late repetition of what was said before
    assert SCAN not in unconfirmed
    unconfirmed.touch([SCAN], Act(8, 1005 * 10**9))
    assert SCAN in unconfirmed
    assert not unconfirmed.hear([said(settled=7)])


def test_who_speaks_on_change_only_confirms_by_saying_nothing_for_as_long_as_observers_need() -> None:
    unconfirmed, delay = after_act(), 2 * 10**9
    on_change, repeated = said(lives=False), said()
    assert unconfirmed.how(on_change, delay, ACT.from_ns + delay - 1) is Confirmed.NOT
    assert unconfirmed.how(on_change, delay, ACT.from_ns + delay) is Confirmed.BY_SILENCE
    assert unconfirmed.how(repeated, delay, ACT.from_ns + 10 * delay) is Confirmed.NOT


def test_what_is_cleared_or_forgotten_needs_no_evidence() -> None:
    unconfirmed = after_act()
    unconfirmed.forget([SCAN])
    assert list(unconfirmed.acts) == [MAP]
    unconfirmed.clear()
    assert not unconfirmed.acts
