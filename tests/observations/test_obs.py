"""OBS ⊕ o: replacement, trends, time, lifetimes; against a naive oracle with permuted arrivals."""

from __future__ import annotations

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.entry import Entry
from robomend.errors import ObservationError
from robomend.model.clauses import Assertion
from robomend.model.formulas import Leaf
from robomend.observations import obs as module
from robomend.observations.obs import Obs
from robomend_client.literals import Atom, Literal, fails, holds


def seen(literal: Literal, time_ns: int = 0, expires_ns: int | None = None, source: str = "test") -> Entry:
    return Entry(literal, source, time_ns, expires_ns)


def test_trends_of_one_value_exclude_each_other() -> None:
    obs = Obs([seen(holds("const", "yaw"), 1)])
    changed = obs.update([seen(holds("inc", "yaw"), 2)])
    assert {str(entry.literal) for entry in changed} == {"inc(yaw)", "not dec(yaw)", "not const(yaw)"}
    assert set(obs.literals(2)) == {holds("inc", "yaw"), fails("dec", "yaw"), fails("const", "yaw")}


def test_matched_is_symmetric() -> None:
    obs = Obs()
    obs.update([seen(holds("matched", "b", "a"), 1)])
    obs.update([seen(fails("matched", "a", "b"), 2)])
    assert obs.literals(2) == (fails("matched", "a", "b"),)


def test_stale_is_unknown_and_neither_true_nor_false() -> None:
    obs = Obs()
    obs.update([seen(holds("ok", "scan"), 1, expires_ns=10)])
    assert obs.literals(9) == (holds("ok", "scan"),)
    assert obs.next_expiry_ns(9) == 10
    assert obs.literals(10) == ()
    assert obs.known(Atom("ok", ("scan",)), 10) is None
    assert obs.next_expiry_ns(10) is None


def test_saying_it_again_after_it_went_stale_is_a_change() -> None:
    obs = Obs()
    obs.update([seen(holds("ok", "scan"), 1, expires_ns=10)])
    assert obs.update([seen(holds("ok", "scan"), 12, expires_ns=20)]) != ()


def test_a_longer_lifetime_reaches_those_who_were_told_that_it_is_stale() -> None:
    obs = Obs()
    obs.update([seen(holds("ok", "scan"), 0, expires_ns=2)])
    assert obs.literals(2) == ()
    assert obs.update([seen(holds("ok", "scan"), 1)]) != ()
    assert obs.literals(2) == (holds("ok", "scan"),)


def test_asking_about_an_earlier_time_brings_back_what_was_fresh_then() -> None:
    obs = Obs()
    obs.update([seen(holds("ok", "scan"), 1, expires_ns=10)])
    assert obs.literals(20) == ()
    assert obs.literals(5) == (holds("ok", "scan"),)


def test_the_next_expiry_is_that_of_the_entry_that_runs_out_first() -> None:
    obs = Obs([seen(holds("ok", "scan"), 1, 20), seen(holds("ok", "map"), 1, 10), seen(holds("ok", "odom"))])
    assert obs.next_expiry_ns(1) == 10
    assert len(obs.literals(1)) == 3
    assert obs.literals(10) == (holds("ok", "scan"), holds("ok", "odom"))
    assert obs.next_expiry_ns(10) == 20


def test_assertions_are_part_of_the_signature_until_withdrawn() -> None:
    obs = Obs([seen(holds("ok", "scan"), 1)])
    before = obs.signature(1)
    obs.add(Assertion("hint", "ok(odom)", Leaf(holds("ok", "odom"))))
    assert obs.signature(1) != before
    assert [*obs.assertions] == ["hint"]
    assert obs.withdraw("hint")
    assert not obs.withdraw("hint")
    assert obs.signature(1) == before


def test_growth_has_a_limit_and_a_refused_batch_leaves_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_ATOMS", 2)
    monkeypatch.setattr(module, "MAX_ASSERTIONS", 1)
    obs = Obs([seen(holds("ok", "a")), seen(holds("ok", "b"))])
    with pytest.raises(ObservationError, match="more than 2 atoms"):
        obs.update([seen(fails("ok", "a"), 1), seen(holds("ok", "c"), 1)])
    assert obs.literals(1) == (holds("ok", "a"), holds("ok", "b"))
    obs.add(Assertion("one", "ok(a)", Leaf(holds("ok", "a"))))
    with pytest.raises(ObservationError, match="withdraw one"):
        obs.add(Assertion("two", "ok(a)", Leaf(holds("ok", "a"))))


def test_can_be_stored_and_rebuilt() -> None:
    obs = Obs()
    obs.update([seen(holds("inc", "yaw"), 3, expires_ns=9), seen(fails("ok", "scan"), 2)])
    again = Obs(pickle.loads(pickle.dumps(obs.entries())), obs.assertions.values())
    assert again.signature(4) == obs.signature(4)
    again.update([seen(holds("ok", "scan"), 1)])
    assert again.signature(4) == obs.signature(4)


# --- against the definition
# ---------------------------------------------------------------------------------------

TRENDS = ("inc", "dec", "const")
literals = st.builds(
    Literal,
    st.sampled_from(
        [Atom("ok", ("scan",)), Atom("ok", ("odom",))]
        + [Atom(trend, (value,)) for trend in TRENDS for value in ("yaw", "x")]
    ),
    st.booleans(),
)


@st.composite
def arrivals(draw: st.DrawFn) -> list[Entry]:
    """Observations of different times, in any order of arrival; some with a lifetime."""
    times = draw(st.lists(st.integers(0, 50), unique=True, max_size=12))
    observed = []
    for time in times:
        lifetime = draw(st.none() | st.integers(1, 30))
        observed.append(seen(draw(literals), time, None if lifetime is None else time + lifetime))
    return observed


def naive(observed: list[Entry], now_ns: int) -> set[Literal]:
    """S ⊕ o of the paper, taken in the order of time; then what is still fresh."""
    known: dict[Literal, Entry] = {}
    for o in sorted(observed, key=lambda o: o.time_ns):
        said = [o.literal]
        if o.literal.positive and o.literal.atom.predicate in TRENDS:
            said += [fails(t, *o.literal.atom.args) for t in TRENDS if t != o.literal.atom.predicate]
        for literal in said:
            known.pop(-literal, None)
            known[literal] = o
    return {literal for literal, o in known.items() if o.expires_ns is None or now_ns < o.expires_ns}


@given(arrivals(), st.integers(0, 100), st.integers(1, 4))
def test_agrees_with_the_definition_whatever_the_order_of_arrival(
    observed: list[Entry], now_ns: int, batch: int
) -> None:
    obs = Obs()
    for start in range(0, len(observed), batch):
        obs.update(observed[start : start + batch])
        obs.literals(now_ns)  # what was computed before must not get in the way
    assert set(obs.literals(now_ns)) == naive(observed, now_ns)
    assert Obs(obs.entries()).signature(now_ns) == obs.signature(now_ns)


@given(arrivals(), st.integers(0, 100))
def test_every_change_of_the_literals_is_reported(observed: list[Entry], now_ns: int) -> None:
    obs = Obs()
    for one in observed:
        before = obs.literals(now_ns)
        changed = obs.update([one])
        if not changed and one.expires_ns is None:
            assert obs.literals(now_ns) == before or one.literal in obs.literals(now_ns)
