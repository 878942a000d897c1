"""Sentences to literals and assertions: every spelling, every complaint with its place."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robomend.errors import ObservationError
from robomend.model.loading import load_text
from robomend.model.sentences import MAX_LENGTH
from robomend.model.vocabulary import Vocabulary
from robomend.observations.language import Assertion, Unknown, parse, read, read_assertion
from robomend_client.literals import Atom, Literal, fails, holds

ROBOT = load_text(
    """
robomend: 1
hardware: {base: {channel: 1}, "left arm": {}}
nodes:
  driver: {drives: [base], publishes: {odom: []}}
  mapper: {publishes: {map: [odom]}}
properties: [temperature]
values: {yaw: {topic: odom, field: z}, turn: {topic: odom, field: w}}
rules: ["ready(base) -> ok(map)", "raining -> ok(odom)"]
"""
).vocabulary


@pytest.mark.parametrize(
    ("sentence", "literals"),
    [
        ("ok(odom)", [holds("ok", "odom")]),
        ("ok (odom)", [holds("ok", "odom")]),
        ("  ok ( odom )  ", [holds("ok", "odom")]),
        ("not ok(odom)", [fails("ok", "odom")]),
        ("~ok(odom)", [fails("ok", "odom")]),
        ("¬ok(odom)", [fails("ok", "odom")]),
        ("not not ok(odom)", [holds("ok", "odom")]),
        ("not_ok(odom)", [fails("ok", "odom")]),
        ("not not_ok(odom)", [holds("ok", "odom")]),
        ("ok(/odom)", [holds("ok", "odom")]),
        ('ok("odom")', [holds("ok", "odom")]),
        ('on("left arm")', [holds("on", "left arm")]),
        ("running(driver) and not running(mapper)", [holds("running", "driver"), fails("running", "mapper")]),
        ("(ok(odom)) and (ok(map) and ok(odom))", [holds("ok", "odom"), holds("ok", "map")]),
        ("con(yaw)", [holds("const", "yaw")]),
        ("not cons(yaw)", [fails("const", "yaw")]),
        ("not_cons(yaw)", [fails("const", "yaw")]),
        ("matched(yaw, turn)", [holds("matched", "turn", "yaw")]),
        ("ok(temperature)", [holds("ok", "temperature")]),
        ("ok(temperature,base)", [holds("ok", "temperature", "base")]),
        ("ok(CPU,driver)", [holds("ok", "CPU", "driver")]),
        ("ok(current(base))", [holds("ok", "current", "base")]),
        ("not ready(base)", [fails("ready", "base")]),
        ("not_raining", [fails("raining")]),
    ],
)
def test_reads_every_spelling(sentence: str, literals: list[Literal]) -> None:
    assert parse(sentence, ROBOT) == tuple(literals)


@pytest.mark.parametrize(
    ("sentence", "position", "message"),
    [
        ("", 0, "empty"),
        ("ok(odm)", 0, "did you mean odom"),
        ("not ok(odm)", 4, "did you mean odom"),
        ("ok(odom) and ok(mapp)", 13, "did you mean map"),
        ("oks(odom)", 0, "did you mean ok"),
        ("on(driver)", 0, "no hardware is named driver"),
        ("on(base,driver)", 0, "takes 1 names, not 2"),
        ('ok(current("left arm"))', 0, "do not go together"),
        ("ok(CPU,base)", 0, "do not go together"),
        ("not ok(base)", 4, "base is hardware: write on(base)"),
        ("running(odom)", 0, "odom is a topic: write ok(odom)"),
        ("ok(driver)", 0, "driver is a node: write running(driver)"),
        ("inc(odom)", 0, "no value is named odom"),
        ("xyzzy", 0, "no predicate is named xyzzy; known are const, dec"),
        ("ok(odom", 7, "expected `,` or `)`"),
        ("ok(odom))", 8, "expected `and`"),
        ("ok()", 3, "expected a name"),
        ("ok(not)", 3, "needs double quotes"),
        ("ok(odom) ok(map)", 9, "expected `and`"),
        ("ok(a b)", 5, "expected `,` or `)`"),
        ('ok("odom)', 3, "not closed"),
        ("ok(odom) §", 9, "unexpected character"),
        ("ok(odom) and not ok(odom)", 0, "both ok(odom) and not ok(odom)"),
        ("ok(odom) or ok(map)", 0, "give it a name"),
        ("true", 0, "give it a name"),
        ("ok(odom) ==> ok(map)", 9, "is not known: write '->'"),
        ("ok(odom)||ok(map)", 8, "is not known: write 'or'"),
        ("ab(base)", 0, "what a diagnosis decides"),
        ("not AB(base)", 4, "what a diagnosis decides"),
    ],
)
def test_complains_with_the_place(sentence: str, position: int, message: str) -> None:
    with pytest.raises(ObservationError) as caught:
        parse(sentence, ROBOT)
    assert message in str(caught.value)
    assert (caught.value.sentence, caught.value.position) == (sentence, position)


def test_length_and_depth_have_limits() -> None:
    for sentence in ("ok(odom)" + " " * MAX_LENGTH, "not " * 200 + "ok(odom)", "(" * 1000, "((" * 200 + "x"):
        with pytest.raises(ObservationError, match=r"characters|deeper"):
            parse(sentence, ROBOT)


@pytest.mark.parametrize("sentence", [5, None, ["ok(odom)"], {"ok": "odom"}])
def test_what_is_no_text_is_refused_as_that(sentence: object) -> None:
    with pytest.raises(ObservationError, match=f"is a string, not {type(sentence).__name__}"):
        read(sentence, ROBOT, name="a1")  # type: ignore[arg-type]  # what JSON may hold


def test_a_rich_sentence_is_an_assertion_and_a_plain_one_is_literals() -> None:
    assert read("ok(odom) and ok(map)", ROBOT, name="x") == (holds("ok", "odom"), holds("ok", "map"))
    rich = read("ok(odom) or not_ok(/map)", ROBOT, name="x")
    assert isinstance(rich, Assertion)
    assert (rich.name, rich.text) == ("x", "ok(odom) or not_ok(/map)")
    assert read_assertion("y", "ok(odom)", ROBOT).name == "y"


def test_an_assertion_names_only_what_is_declared() -> None:
    with pytest.raises(ObservationError, match="did you mean odom") as caught:
        read_assertion("x", "ok(map) or ok(odm)", ROBOT)
    assert caught.value.position == 11
    with pytest.raises(ObservationError, match="diagnosis decides"):
        read_assertion("x", "forall n in nodes: ab(n) or running(n)", ROBOT)
    read_assertion("x", "ok(map) or ok(odm)", ROBOT, unknown="keep")


names = st.text(min_size=1, max_size=8).filter(lambda name: not name.startswith("/"))


@given(names, st.lists(names, max_size=3), st.booleans())
@example("not", ["and", "->"], True)
@example("a->b", ['"', "\\", '\\"'], False)
@example("ok", ["true", " ", "\n"], True)
def test_every_literal_is_read_back_from_its_text(predicate: str, args: list[str], positive: bool) -> None:
    literal = Literal(Atom(predicate, tuple(args)), positive)
    vocabulary = Vocabulary(atoms=frozenset({literal.atom}))
    (back,) = parse(str(literal), vocabulary, unknown="keep")
    assert back == vocabulary.canonical(literal)


@given(st.text(alphabet='okab()",~!→-><:∧ notrfadl/inwhere.\\', max_size=60) | st.text(max_size=30))
def test_garbage_raises_observation_errors_only(sentence: str) -> None:
    policies: tuple[Unknown, ...] = ("refuse", "keep")
    for unknown in policies:
        place = 0
        try:
            parse(sentence, ROBOT, unknown=unknown)
            read(sentence, ROBOT, name="x")
        except ObservationError as error:
            place = error.position
        assert 0 <= place <= len(sentence)
