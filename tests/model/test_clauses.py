"""User rules, fault modes and assertions become clauses that mean what the sentences say."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pysat.solvers import Solver

from robomend.diagnosis.engines import make_engine
from robomend.errors import ModelError
from robomend.model.clauses import Assertion, compile_rules, describe, extend, without_running
from robomend.model.cnf import HealthCnf, Rule
from robomend.model.formulas import And, Formula, Iff, Implies, Leaf, Not, Or, Truth, ab
from robomend.model.loading import load_model, load_text
from robomend.model.sentences import parse as parse_formula
from robomend.model.system import System
from robomend.observations.language import read_assertion
from robomend.resources import resource
from robomend_client.literals import Literal, fails, holds

ATOMS = [holds("p"), holds("q"), holds("r")]


def value(formula: Formula, true: frozenset[Literal]) -> bool:
    """The textbook meaning."""
    match formula:
        case Leaf(literal):
            return (literal in true) if literal.positive else (-literal not in true)
        case Truth(known):
            return known
        case Not(body):
            return not value(body, true)
        case And(parts):
            return all(value(part, true) for part in parts)
        case Or(parts):
            return any(value(part, true) for part in parts)
        case Implies(left, right):
            return not value(left, true) or value(right, true)
        case Iff(left, right):
            return value(left, true) == value(right, true)
        case _:
            raise AssertionError(formula)


def models(cnf: HealthCnf) -> set[frozenset[str]]:
    """Every assignment of health and atoms, as the words that hold, that some auxiliary values extend."""
    named = range(1, len(cnf.components) + len(cnf.atoms) + 1)
    found = set()
    with Solver("glucose4", bootstrap_with=cnf.clauses) as solver:
        for signs in product((1, -1), repeat=len(named)):
            chosen = [sign * variable for sign, variable in zip(signs, named, strict=True)]
            if solver.solve(assumptions=chosen):
                found.add(frozenset(cnf.word(literal) for literal in chosen))
    return found


def expected(formulas: list[Formula], components: tuple[str, ...]) -> set[frozenset[str]]:
    used = [*(ab(c) for c in components), *ATOMS]
    found = set()
    for signs in product((True, False), repeat=len(used)):
        true = frozenset(literal for literal, sign in zip(used, signs, strict=True) if sign)
        if all(value(formula, true) for formula in formulas):
            found.add(frozenset(str(x) if x in true else str(-x) for x in used))
    return found


leaf = st.builds(
    lambda literal, positive: Leaf(literal if positive else -literal),
    st.sampled_from([*ATOMS, ab("x"), ab("y")]),
    st.booleans(),
)
formulas = st.recursive(
    leaf | st.builds(Truth, st.booleans()),
    lambda inner: (
        st.builds(Not, inner)
        | st.builds(And, st.lists(inner, max_size=3).map(tuple))
        | st.builds(Or, st.lists(inner, max_size=3).map(tuple))
        | st.builds(Implies, inner, inner)
        | st.builds(Iff, inner, inner)
    ),
    max_leaves=12,
)
EVERY_ATOM = (Or((*(Leaf(atom) for atom in ATOMS), Truth(True))), Rule("", ""))


@given(st.lists(formulas, max_size=3), st.integers(0, 16))
def test_clauses_have_exactly_the_models_of_the_rules(drawn: list[Formula], distribute: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robomend.model.clauses.DISTRIBUTE", distribute)  # 0: auxiliary variables everywhere
        cnf = compile_rules(
            "r", ("x", "y"), [(f, Rule(describe(f), "user rule")) for f in drawn] + [EVERY_ATOM]
        )
    assert models(cnf) == expected(drawn, ("x", "y"))


@given(formulas, formulas)
def test_an_assertion_adds_exactly_what_it_says(rule: Formula, asserted: Formula) -> None:
    # the assertion brings p, q and r, which shifts the auxiliary variables of the rule
    plain = compile_rules("r", ("x", "y"), [(rule, Rule("", ""))])
    both = extend(plain, [Assertion("a", "…", And((asserted, EVERY_ATOM[0])))])
    assert models(both) == expected([rule, asserted], ("x", "y"))
    assert extend(plain, []) is plain


@given(formulas)
def test_every_formula_is_read_back_from_its_text(formula: Formula) -> None:
    back = parse_formula(describe(formula))
    used = [*ATOMS, ab("x"), ab("y")]
    for signs in product((True, False), repeat=len(used)):
        true = frozenset(literal for literal, sign in zip(used, signs, strict=True) if sign)
        assert value(back, true) == value(formula, true)


def test_deep_equivalences_stay_small() -> None:
    formula: Formula = Leaf(holds("p0"))
    for index in range(1, 50):
        formula = Iff(formula, Leaf(holds(f"p{index}")))
    cnf = compile_rules("r", ("x",), [(Implies(Leaf(-ab("x")), formula), Rule("", ""))])
    assert len(cnf.clauses) < 1000


# --- rules of the user's
# -------------------------------------------------------------------------------------------

ROBOT = """
robomend: 1
hardware: {router: {}, arm: {channel: 1}}
nodes: {driver: {drives: [arm], publishes: {joints: []}}, talker: {publishes: {chat: [joints]}}}
properties: [link]
"""


def with_rule(rule: str) -> HealthCnf:
    return load_text(f"{ROBOT}\nrules:\n  - '{rule}'\n").cnf


def said(cnf: HealthCnf) -> set[frozenset[str]]:
    """The clauses of the user's rules."""
    return {
        frozenset(cnf.word(literal) for literal in clause)
        for clause, origin in zip(cnf.clauses, cnf.origins, strict=True)
        if cnf.rules[origin].source.startswith("user rule")
    }


@pytest.mark.parametrize(
    ("rule", "clauses", "weak"),
    [
        ("not ab(router) -> ok(link)", [{"ab(router)", "ok(link)"}], True),
        (
            "ok(link) <-> not ab(router)",
            [{"not ok(link)", "not ab(router)"}, {"ab(router)", "ok(link)"}],
            False,
        ),
        ("ab(router) -> not ok(link)", [{"not ab(router)", "not ok(link)"}], False),
        ("AB(router) -> not_ok(link)", [{"not ab(router)", "not ok(link)"}], False),
        ("NAB(/router) -> ok(/link)", [{"ab(router)", "ok(link)"}], True),
        ("ready(arm) or not_ready(talker)", [{"ready(arm)", "not ready(talker)"}], True),
        ("raining -> not ok(link)", [{"not raining", "not ok(link)"}], True),
        (
            "forall n in nodes, h in hardware where drives(n, h): on(h) -> running(n)",
            [{"not on(arm)", "running(driver)"}],
            True,
        ),
        (
            "forall n in nodes where not drives(n, arm): running(n)",
            [{"running(talker)"}],
            True,
        ),
        ("exists n in nodes: running(n)", [{"running(driver)", "running(talker)"}], True),
        ("forall n, m in nodes where not same(n, m): running(n) or running(m)",
         [{"running(driver)", "running(talker)"}], True),
        ("forall v in values: const(v)", [], True),
    ],
)  # fmt: skip
def test_rules_of_any_shape(rule: str, clauses: list[set[str]], weak: bool) -> None:
    cnf = with_rule(rule)
    assert said(cnf) == {frozenset(clause) for clause in clauses}
    assert cnf.weak == weak


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("ab(rooter) -> ok(link)", "did you mean 'router'"),
        ("on(amr)", "no hardware is named amr; did you mean arm"),
        ("running(router)", "no node is named router"),
        ("ok(link", "position 7"),
        ("forall x in robots: ok(link)", "no sort is named `robots`"),
        ("forall n in nodes where driving(n, arm): ok(link)", "no relation is named `driving`; did you mean"),
        ("forall n in nodes, n in nodes: running(n)", "bound already"),
        ("", "empty"),
    ],
)
def test_wrong_rules_are_refused_with_their_line(rule: str, message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        with_rule(rule)
    assert caught.value.line == 8


# --- fault modes
# -----------------------------------------------------------------------------------------------------

MODES = """
robomend: 1
hardware: {arm: {channel: 1, modes: {stuck: ["const(joint)"], blind: ["not ok(joints)", "on(arm)"]}}}
nodes: {driver: {drives: [arm], publishes: {joints: []}}}
values: {joint: {topic: joints, field: position}}
"""


def modes_of(cnf: HealthCnf, *literals: str) -> set[frozenset[str]]:
    """Which modes can hold together, given some words."""
    word = {
        cnf.word(sign * v): sign * v
        for v in range(1, 8)
        for sign in (1, -1)
        if v <= len(cnf.components) + len(cnf.atoms)
    }
    found = set()
    with Solver("glucose4", bootstrap_with=cnf.clauses) as solver:
        variables = cnf.modes["arm"]
        for signs in product((1, -1), repeat=len(variables)):
            chosen = [sign * v for sign, v in zip(signs, variables.values(), strict=True)]
            if solver.solve(assumptions=[*chosen, *(word[literal] for literal in literals)]):
                found.add(frozenset(m for m, sign in zip(variables, signs, strict=True) if sign > 0))
    return found


def only(*names: str) -> set[frozenset[str]]:
    return {frozenset({name}) for name in names}


def test_an_abnormal_component_is_in_exactly_one_mode() -> None:
    cnf = load_text(MODES).cnf
    assert not cnf.weak
    assert modes_of(cnf, "ab(arm)") == only("stuck", "blind", "unknown")
    assert modes_of(cnf, "not ab(arm)") == {frozenset()}


def test_exhaustive_modes_leave_no_other_way_to_fail() -> None:
    cnf = load_text(MODES.replace("channel: 1,", "channel: 1, exhaustive_modes: true,")).cnf
    assert modes_of(cnf, "ab(arm)") == only("stuck", "blind")
    assert modes_of(cnf, "ab(arm)", "not const(joint)", "ok(joints)") == set()


def test_assertions_keep_the_modes() -> None:
    system = load_text(MODES)
    assertion = read_assertion("hint", "ok(joints) or running(driver) -> not const(joint)", system.vocabulary)
    more = extend(system.cnf, [assertion, read_assertion("new", "dec(joint)", system.vocabulary)])
    assert more.rules[-1] == Rule("dec(joint)", "assertion new")
    assert modes_of(more, "ab(arm)", "ok(joints)") == only("unknown")


# --- expected to be stopped
# ---------------------------------------------------------------------------------------------


def test_nodes_expected_to_be_stopped_lose_what_they_do_while_they_work() -> None:
    cnf = load_model(resource("examples", "tedusar.yaml")).cnf
    fewer = without_running(cnf, ["rviz", "hector_mapping", "nobody"])
    gone = set(cnf.clauses) - set(fewer.clauses)
    assert {cnf.rules[cnf.origins[cnf.clauses.index(clause)]].text for clause in gone} == {
        "not ab(rviz) -> running(rviz)",
        "not ab(hector_mapping) -> running(hector_mapping)",
        "not ab(hector_mapping) and ok(scan) -> ok(map)",
    }
    assert len(fewer.clauses) == len(fewer.origins) == 15
    assert without_running(cnf, []) is cnf


def test_a_spare_that_is_meant_to_be_off_is_not_expected_to_be_on() -> None:
    nodes = "{driver: {drives: [lidar]}, spare_driver: {drives: [spare], publishes: {scan_b: []}}}"
    hardware = "{psu: {channel: 0}, lidar: {channel: 1, fed_by: [psu]}, spare: {channel: 2, fed_by: [psu]}}"
    cnf = load_text(f"robomend: 1\nhardware: {hardware}\nnodes: {nodes}\n").cnf
    fewer = without_running(cnf, ["spare"])
    gone = [cnf.rules[origin].text for origin in cnf.origins if origin not in fewer.origins]
    assert gone == [
        "not ab(spare) and on(psu) -> on(spare)",
        "not ab(spare_driver) and not ab(spare) and on(spare) and not ab(psu) -> ok(scan_b)",
    ]


def test_the_silence_of_a_topic_is_expected_only_if_nobody_else_publishes_it() -> None:
    nodes = "{voice: {publishes: {speech: [text]}}, player: {publishes: {sound: [speech]}}}"
    alone = f"robomend: 1\ntopics: [text]\nnodes: {nodes}\n"
    seen = [holds("ok", "text"), fails("ok", "speech"), fails("ok", "sound")]
    assert bad_of(load_text(alone).extended(expected_stopped=["voice"]), seen) == [()]
    other = alone.replace("player:", "spare_voice: {publishes: {speech: [text]}}, player:")
    assert bad_of(load_text(other).extended(expected_stopped=["voice"]), seen) == [("spare_voice",)]


def bad_of(system: System, seen: list[Literal]) -> list[tuple[str, ...]]:
    engine = make_engine("sat", system.cnf)
    try:
        return [diagnosis.bad for diagnosis in engine.diagnose(seen).diagnoses]
    finally:
        engine.close()
