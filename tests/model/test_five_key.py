"""Five-key files: read, compiled, written back; what is wrong in them is named with its line."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.errors import ModelError
from robomend.model.clauses import compile_rules
from robomend.model.cnf import HealthCnf, Rule
from robomend.model.five_key import FiveKey, five_key_of, read_five_key, system_of, write_five_key
from robomend.model.formulas import Leaf, Or
from robomend.model.loading import load_model, load_text
from robomend.resources import resource
from robomend_client.literals import Atom, Literal
from robomend_client.yaml_tree import read_tree

RELEASED = """\
ab: "AB"
nab: "NAB"
neg_prefix: "not_"
props: [ running(laser), ok(laser_node_topic) , NAB(imu), cons(yaw)]
rules: [ "NAB(laser)->running(laser)", "NAB(laser)->ok(laser_node_topic)",
  "NAB(/mapper), ok(laser_node_topic) -> ok (map)",
  "AB(jaguar)->not_on(jaguar)",
  "ok(map),not_ok(map)->false",
  "not_running(laser)->AB(laser)" ]
"""


def clauses(cnf: HealthCnf) -> list[set[str]]:
    return [{cnf.word(literal) for literal in clause} for clause in cnf.clauses]


def test_reads_the_published_form() -> None:
    system = load_text(RELEASED, name="laser")
    assert system.format == "five-key"
    assert set(system.cnf.components) == {"imu", "laser", "mapper", "jaguar"}
    assert clauses(system.cnf) == [
        {"ab(laser)", "running(laser)"},
        {"ab(laser)", "ok(laser_node_topic)"},
        {"ab(mapper)", "not ok(laser_node_topic)", "ok(map)"},
        {"not ab(jaguar)", "not on(jaguar)"},
        {"ab(laser)", "running(laser)"},
    ]
    assert [rule.line for rule in system.cnf.rules] == [5, 5, 6, 7, 8, 9]
    assert not system.cnf.weak


def test_warns_of_propositions_that_are_used_and_not_listed() -> None:
    warnings = load_text(RELEASED).warnings
    assert len(warnings) == 2
    assert "ok(map)" in warnings[0]
    assert "on(jaguar)" in warnings[1]


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("NAB(a)", "exactly one `->`"),
        ("a->b->c", "exactly one `->`"),
        ("a->", "no literal"),
        ("a(->b", "no literal"),
        ("a or b->c", "no literal"),
        ("true->false", "says false"),
        ('"a->b', "not closed"),
    ],
)
def test_a_rule_that_does_not_parse_is_refused_with_its_line(rule: str, message: str) -> None:
    text = f"ab: AB\nnab: NAB\nneg_prefix: not_\nprops: []\nrules:\n  - p->q\n  - '{rule}'\n"
    with pytest.raises(ModelError) as caught:
        load_text(text, file="robot.yaml")
    assert str(caught.value).startswith("robot.yaml:7: rule 2")
    assert message in str(caught.value)


def test_a_proposition_that_does_not_parse_is_refused_with_its_line() -> None:
    text = "ab: AB\nnab: NAB\nneg_prefix: not_\nprops:\n  - on(a)\n  - 'b c'\nrules: []\n"
    with pytest.raises(ModelError) as caught:
        load_text(text, file="robot.yaml")
    assert str(caught.value).startswith("robot.yaml:6: proposition `b c`")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ab: AB\nnab: NAB\nneg_prefix: not_\nprops: []\n", "`rules` is missing"),
        ("ab: AB\nnab: AB\nneg_prefix: not_\nprops: []\nrules: []", "must differ"),
        ("ab: AB\nnab: NAB\nneg_prefix: not_\nprops: []\nrules: p->q", "list of strings"),
        ("ab: AB\nnab: NAB\nneg_prefix: not_\nprops: []\nrules: [[p]]", "list of strings"),
        ("ab: [x]\nnab: NAB\nneg_prefix: not_\nprops: []\nrules: []", "`ab` is a word"),
        ("ab: AB\nnab: NAB\nneg_prefix: not_\nprops: []\nrules: []\nnodes: {}", "no key `nodes`"),
        ("ab: AB\nnab: NAB\nneg_prefix: not_\nprops: ['a b']\nrules: []", "no literal"),
    ],
)
def test_other_mistakes_are_named(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load_text(text)


def test_a_component_model_survives_the_way_through_five_keys() -> None:
    original = load_model(resource("examples", "tedusar.yaml")).cnf
    written = write_five_key(five_key_of(original))
    assert '"NAB(imu)"' in written
    assert '"NAB(hector_mapping),ok(scan)->ok(map)"' in written
    back = load_text(written).cnf
    assert clauses(back) == clauses(original)
    assert set(back.components) == set(original.components)
    assert load_text(written).warnings == ()


words = st.text(alphabet="abAN_.-", min_size=1, max_size=4)
odd = st.text(min_size=1, max_size=4).filter(lambda name: not name.startswith("/") and name.isprintable())
literals = st.builds(
    Literal,
    st.builds(Atom, words | odd, st.lists(words | odd, max_size=2).map(tuple)).filter(
        lambda atom: atom.predicate not in ("ab", "AB", "con", "cons") and atom.args != ("",)
    ),
    st.booleans(),
)
healths = st.builds(lambda c, sign: Literal(Atom("ab", (c,)), sign), st.sampled_from("xyz"), st.booleans())


@given(st.lists(st.lists(literals | healths, min_size=1, max_size=4), max_size=6))
def test_any_clauses_are_read_back_as_written(drawn: list[list[Literal]]) -> None:
    rules = [(Or(tuple(Leaf(literal) for literal in clause)), Rule("", "user rule")) for clause in drawn]
    cnf = compile_rules("r", ("x", "y", "z"), rules)
    model = five_key_of(cnf)
    back = system_of(read_five_key(read_tree(write_five_key(model)))).cnf
    assert clauses(back) == clauses(cnf)
    assert set(back.components) == set(cnf.components)


@given(
    st.builds(
        FiveKey,
        st.just("AB"),
        st.just("NAB"),
        st.sampled_from(["not_", "~", "n"]).filter(str.isidentifier),
        st.lists(st.text(max_size=8).filter(str.isprintable), max_size=4).map(tuple),
        st.lists(st.text(max_size=8).filter(str.isprintable), max_size=4).map(tuple),
    )
)
def test_the_keys_themselves_are_read_back_as_written(model: FiveKey) -> None:
    back = read_five_key(read_tree(write_five_key(model)))
    assert (back.ab, back.nab, back.neg_prefix, back.props, back.rules) == (
        model.ab,
        model.nab,
        model.neg_prefix,
        model.props,
        model.rules,
    )
