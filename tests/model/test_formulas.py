"""What can be read off a formula without solving anything."""

from __future__ import annotations

import re

import pytest

from robomend.errors import ObservationError
from robomend.model.formulas import And, Leaf, Not, Or, Truth, conjuncts
from robomend.model.sentences import MAX_DEPTH, parse, tokens
from robomend_client.literals import holds

P, Q, R = holds("p"), holds("q"), holds("r")


def test_anything_richer_is_no_conjunction() -> None:
    either = Or((Leaf(P), Leaf(Q)))
    for formula in (
        either,
        And((Leaf(R), either)),
        And((either, Leaf(R))),
        Not(And((Leaf(P),))),
        Truth(True),
    ):
        assert conjuncts(formula) is None


def test_a_sentence_is_nested_so_deep_and_no_deeper() -> None:
    assert conjuncts(parse("not " * (MAX_DEPTH // 2) + "p")) == (P,)
    for deep in ("not " * 10 * MAX_DEPTH + "p", "(" * 10 * MAX_DEPTH + "p" + ")" * 10 * MAX_DEPTH):
        with pytest.raises(ObservationError, match=f"nested deeper than {MAX_DEPTH}"):
            parse(deep)


@pytest.mark.parametrize(
    ("sentence", "position", "instead"),
    [
        ("not ab(a) => ok(b)", 10, "->"),
        ("not ab(a) ==> ok(b)", 10, "->"),
        ("ok(a) <=> ok(b)", 6, "<->"),
        ("ok(a) && ok(b)", 6, "and"),
        ("ok(a)||ok(b)", 5, "or"),
    ],
)
def test_a_sign_of_another_language_is_told_with_the_one_to_write(
    sentence: str, position: int, instead: str
) -> None:
    with pytest.raises(ObservationError, match=re.escape(f"is not known: write '{instead}'")) as caught:
        tokens(sentence)
    assert caught.value.position == position
