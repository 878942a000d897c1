"""What others say on /observations."""

from __future__ import annotations

import pytest

from robomend_client.bridges.listening import MOST_ATOMS, Sentences, read_sentence
from robomend_client.bridges.names import Names, resolved
from robomend_client.literals import Literal, fails, holds


@pytest.mark.parametrize(
    ("text", "literals"),
    [
        ("ok (temp_cpu1) and ok (temp_cpu2)", [holds("ok", "temp_cpu1"), holds("ok", "temp_cpu2")]),
        ("not ok (temp_cpu1)", [fails("ok", "temp_cpu1")]),
        ("~ok(scan)", [fails("ok", "scan")]),
        ("~Ok(map_Triggered)", [fails("ok", "map_Triggered")]),
        ("n_ok(hokuyo)", [fails("ok", "hokuyo")]),
        ("not_running(hokuyo_node)", [fails("running", "hokuyo_node")]),
        ("con(odom_yaw)", [holds("const", "odom_yaw")]),
        ("ok(CPU,hokuyo_node)", [holds("ok", "CPU", "hokuyo_node")]),
        ("note(x)", [holds("note", "x")]),
        ("not_today(x)", [holds("not_today", "x")]),
        ("n_items(x)", [holds("n_items", "x")]),
        ("ok(/scan)", [holds("ok", "scan")]),
        ('~ok("a b") & on(j)', [fails("ok", "a b"), holds("on", "j")]),
    ],
)  # fmt: skip
def test_the_spellings_of_the_paper_and_of_its_released_observers(text: str, literals: list[Literal]) -> None:
    assert read_sentence(text) == literals


@pytest.mark.parametrize("text", ["", "ok", "ok(", "ok(a) or ok(b)", "a -> b", "not not ok(a)", "x" * 5000])
def test_what_is_no_conjunction_of_literals_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        read_sentence(text)


def test_names_of_values_are_those_of_the_model() -> None:
    names = Names("/robot1", {"odom_yaw": "odom_twist.twist.angular.z"})
    (found,) = read_sentence("con(odom_twist.twist.angular.z)", lambda name: names.ours(resolved(name)))
    assert found == holds("const", "odom_yaw")
    (found,) = read_sentence("ok(/robot1/scan)", lambda name: names.ours(resolved(name)))
    assert found == holds("ok", "scan")


def test_a_sentence_holds_until_its_opposite_or_until_nobody_repeats_it() -> None:
    sentences = Sentences(10)
    ok, bad = holds("ok", "scan"), fails("ok", "scan")
    assert [change.value for change in sentences.heard([ok], 1)] == [ok]
    assert sentences.heard([ok], 5) == []
    assert [(verdict.literal, verdict.since_ns) for verdict in sentences.standing()] == [(ok, 5)]
    assert [change.value for change in sentences.heard([bad], 6)] == [bad]
    assert sentences.expired(15) == []
    (gone,) = sentences.expired(16)
    assert (gone.atom, gone.value) == (ok.atom, None)
    assert sentences.standing() == []


def test_a_flood_of_names_has_a_bound() -> None:
    sentences = Sentences(10)
    for number in range(MOST_ATOMS + 5):
        sentences.heard([holds("ok", str(number))], 1)
    assert len(sentences.standing()) == MOST_ATOMS
