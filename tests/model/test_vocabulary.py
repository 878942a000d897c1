"""One spelling per literal; what is declared, and hints for what is not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robomend.errors import ObservationError
from robomend.model.compiling import vocabulary_of
from robomend.model.components import ComponentModel, Hardware, Node, Value
from robomend_client.literals import Atom, Literal, fails, holds

ROBOT = replace(
    vocabulary_of(
        ComponentModel(
            "robot",
            {"base": Hardware("base", 1), "lamp": Hardware("lamp", None)},
            {"driver": Node("driver", publishes={"odom": ()})},
            {},
            properties=("temperature",),
            values={name: Value(name, "odom", name) for name in ("yaw", "turn")},
        )
    ),
    atoms=frozenset({Atom("raining"), Atom("note", ("x",))}),
)


@pytest.mark.parametrize(
    ("literal", "canonical"),
    [
        (holds("ok", "/odom"), holds("ok", "odom")),
        (holds("con", "yaw"), holds("const", "yaw")),
        (fails("cons", "yaw"), fails("const", "yaw")),
        (holds("matched", "yaw", "turn"), holds("matched", "turn", "yaw")),
        (holds("not_ok", "odom"), fails("ok", "odom")),
        (fails("not_ok", "odom"), holds("ok", "odom")),
        (holds("not_raining"), fails("raining")),
        (holds("note", "x"), holds("note", "x")),
        (holds("not_known", "x"), holds("not_known", "x")),
    ],
)
def test_every_spelling_has_one_canonical_form(literal: Literal, canonical: Literal) -> None:
    assert ROBOT.canonical(literal) == canonical
    assert ROBOT.canonical(canonical) == canonical


@pytest.mark.parametrize(
    "literal",
    [
        holds("on", "lamp"),
        holds("running", "driver"),
        holds("ok", "odom"),
        holds("ok", "temperature"),
        holds("ok", "temperature", "lamp"),
        holds("ok", "Mem", "driver"),
        holds("ok", "current", "base"),
        holds("inc", "yaw"),
        holds("matched", "yaw", "turn"),
        holds("raining"),
    ],
)
def test_declared_literals_pass(literal: Literal) -> None:
    ROBOT.check(literal)


@pytest.mark.parametrize(
    ("literal", "message"),
    [
        (holds("on", "lamb"), "no hardware is named lamb; did you mean lamp?"),
        (holds("ok", "current", "lamp"), "do not go together"),
        (holds("ok", "CPU", "base"), "do not go together"),
        (fails("ok", "base"), "base is hardware: write on(base)"),
        (holds("running", "odom"), "odom is a topic: write ok(odom)"),
        (holds("ok", "driver"), "driver is a node: write running(driver)"),
        (holds("inc", "odom"), "no value is named odom"),
        (holds("runing", "driver"), "did you mean running"),
        (holds("raining", "x"), "takes 0 names, not 1"),
        (holds("xyzzy"), "no predicate is named xyzzy; known are const, dec"),
        (holds("ab", "base"), "what a diagnosis decides"),
    ],
)
def test_undeclared_literals_are_refused_with_a_hint(literal: Literal, message: str) -> None:
    with pytest.raises(ObservationError) as caught:
        ROBOT.check(literal, "the sentence", 4)
    assert message in str(caught.value)
    assert (caught.value.sentence, caught.value.position) == ("the sentence", 4)
