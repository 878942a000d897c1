"""The six schemes on random models, against a second reading of section IV-D; then the opt-in keys."""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.engines import make_engine
from robomend.model.cnf import HealthCnf, Output
from robomend.model.compiling import compile_robot
from robomend.model.components import ComponentModel, Hardware, Node, Topic, Value
from robomend.model.loading import load_text
from robomend.model.schemes import outputs
from robomend.observations.language import parse
from robomend_client.literals import holds

Words = frozenset[str]


@st.composite
def robots(draw: st.DrawFn) -> ComponentModel:
    """Robots of up to five devices and five nodes, drivers of every kind, shared topics, related values."""
    channels = draw(st.lists(st.none() | st.integers(0, 9), max_size=5))
    taken: set[int] = set()
    hardware: dict[str, Hardware] = {}
    for index, channel in enumerate(channels):
        free = channel if channel not in taken else None
        taken |= {channel} if channel is not None else set()
        hardware[f"h{index}"] = Hardware(f"h{index}", free)
    topics = [f"t{index}" for index in range(draw(st.integers(1, 5)))]
    some_topics = st.lists(st.sampled_from(topics), unique=True, max_size=3)
    nodes: dict[str, Node] = {}
    for index in range(draw(st.integers(1, 5))):
        drives = draw(st.lists(st.sampled_from([*hardware]), unique=True, max_size=2)) if hardware else []
        published = draw(some_topics)
        inputs = {topic: () if drives else tuple(draw(some_topics)) for topic in published}
        nodes[f"n{index}"] = Node(f"n{index}", tuple(drives), inputs)
    values = {f"v{i}": Value(f"v{i}", draw(st.sampled_from(topics)), "x") for i in range(3)}
    pairs = [("v0", "v1"), ("v1", "v0"), ("v1", "v2")]
    related = draw(st.lists(st.sampled_from(pairs), unique=True, max_size=3))
    return ComponentModel(
        "r", hardware, nodes, {t: Topic(t) for t in topics}, values=values, related=tuple(related)
    )


def paper(model: ComponentModel) -> set[Words]:
    """The clauses as sets of words, straight from the formulas and sets of section IV-D."""
    components = {*model.hardware, *model.nodes}
    sh = {h for h in model.hardware if model.hardware[h].channel is not None}
    other = set(model.hardware) - sh
    hw = {n: set(model.nodes[n].drives) & sh for n in model.nodes}
    sn = {n for n in model.nodes if hw[n]}
    hn = {n for n in model.nodes if model.nodes[n].drives} - sn
    plain = set(model.nodes) - sn - hn
    out = {n: set(model.nodes[n].publishes) for n in model.nodes}
    found: set[Words] = set()
    found |= {frozenset({f"ab({h})", f"on({h})"}) for h in sh}
    found |= {frozenset({f"ab({s})", *(f"ab({h})" for h in hw[s]), f"ok({t})"}) for s in sn for t in out[s]}
    found |= {frozenset({f"ab({h})", f"ok({t})"}) for h in hn for t in out[h]}
    found |= {
        frozenset({f"ab({n})", *(f"not ok({i})" for i in model.nodes[n].publishes[t]), f"ok({t})"})
        for n in plain
        for t in out[n]
        if t not in model.nodes[n].publishes[t]  # ok(t) -> ok(t) says nothing
    }
    found |= {frozenset({f"ab({n})", f"running({n})"}) for n in components - (other | sh)}
    for n1, n2 in product(model.nodes, repeat=2):
        for v1, v2 in model.related:
            if model.values[v1].topic in out[n1] and model.values[v2].topic in out[n2]:
                word = f"matched({min(v1, v2)},{max(v1, v2)})"
                found.add(frozenset({f"ab({n1})", f"ab({n2})", word}))
    return found


def words(cnf: HealthCnf) -> list[Words]:
    return [frozenset(cnf.word(literal) for literal in clause) for clause in cnf.clauses]


@given(robots())
def test_compiles_to_the_clauses_of_the_paper_and_no_others(model: ComponentModel) -> None:
    cnf = compile_robot(model).cnf
    assert set(words(cnf)) == paper(model)
    assert cnf.weak
    assert cnf.components == (*model.hardware, *model.nodes)


@given(robots())
def test_every_clause_reads_like_its_rule(model: ComponentModel) -> None:
    cnf = compile_robot(model).cnf
    for clause, origin in zip(words(cnf), cnf.origins, strict=True):
        premises, _, conclusion = cnf.rules[origin].text.partition(" -> ")
        negated = {
            p.removeprefix("not ") if p.startswith("not ") else f"not {p}" for p in premises.split(" and ")
        }
        assert clause == negated | {conclusion}


def clauses(text: str, **keys: Any) -> set[Words]:
    return set(words(load_text("robomend: 1\n" + text, **keys).cnf))


def clause(*of: str) -> Words:
    return frozenset(of)


def test_a_device_without_channel_beside_a_switchable_one_adds_nothing() -> None:
    text = "hardware: {a: {channel: 1}, b: {}}\nnodes: {n: {drives: [a, b], publishes: {t: []}}}"
    assert clause("ab(n)", "ab(a)", "ok(t)") in clauses(text)
    cnf = load_text(f"robomend: 1\n{text}").cnf
    assert [rule.source for rule in cnf.rules if "ok(t)" in rule.text] == ["scheme 2"]


def test_blame_hardware_puts_a_device_without_channel_into_its_drivers_clause() -> None:
    text = "hardware: {b: {}}\nnodes: {n: {drives: [b], publishes: {t: []}}}"
    assert clause("ab(n)", "ok(t)") in clauses(text)
    assert clause("ab(n)", "ab(b)", "ok(t)") in clauses("blame_hardware: true\n" + text)
    own = text.replace("b: {}", "b: {blame_hardware: true}")
    assert clause("ab(n)", "ab(b)", "ok(t)") in clauses(own)
    not_this = text.replace("b: {}", "b: {blame_hardware: false}")
    assert clause("ab(n)", "ok(t)") in clauses("blame_hardware: true\n" + not_this)


def test_inputs_of_a_driver_count_only_when_asked() -> None:
    found = clauses(
        "hardware: {a: {channel: 1}}\ntopics: [cmd]\n"
        "nodes: {n: {drives: [a], inputs_matter: true, publishes: {t: [cmd]}}}"
    )
    assert clause("ab(n)", "ab(a)", "not ok(cmd)", "ok(t)") in found


def test_a_failure_silences_what_the_node_publishes_and_of_a_device_what_all_publish_that_it_powers() -> None:
    nodes = (
        Node("driver", ("a",), {"t": ("cmd",)}),
        Node("careful", ("a",), {"u": ("cmd",)}, inputs_matter=True),
        Node("user", (), {"v": ("t",)}),
    )
    devices = {"a": Hardware("a", 1, fed_by=("psu",)), "psu": Hardware("psu")}
    model = ComponentModel("robot", devices, {node.name: node for node in nodes}, {})
    cmd, t, u, v = (holds("ok", name).atom for name in ("cmd", "t", "u", "v"))
    by_driver, by_careful = Output(t, "driver"), Output(u, "careful", (cmd,))
    assert outputs(model) == {
        "driver": (by_driver,),
        "careful": (by_careful,),
        "user": (Output(v, "user", (t,)),),
        "a": (by_driver, by_careful),
        "psu": (by_driver, by_careful),
    }


def test_power_is_a_chain_and_who_gets_none_is_not_to_blame() -> None:
    found = clauses(
        "hardware: {psu: {}, hub: {channel: 1, fed_by: [psu]}, cam: {fed_by: hub}}\n"
        "nodes: {n: {drives: [cam], publishes: {t: []}}, m: {drives: [hub], publishes: {u: []}}}"
    )
    assert found == {
        clause("ab(psu)", "on(psu)"),
        clause("ab(hub)", "not on(psu)", "on(hub)"),
        clause("ab(cam)", "not on(hub)", "on(cam)"),
        # On a channel on(hub) is a relay's position: that the supply works is said apart.
        clause("ab(m)", "ab(hub)", "not on(hub)", "ab(psu)", "ok(u)"),
        clause("ab(n)", "not on(cam)", "ab(hub)", "ab(psu)", "ok(t)"),
        clause("ab(n)", "running(n)"),
        clause("ab(m)", "running(m)"),
    }


LOADED = """
hardware: {pc: {computer: true}, cam: {channel: 1}}
nodes:
  camera: {drives: [cam], publishes: {image: []}, host: pc}
  slam: {publishes: {map: [image]}, host: pc}
  gps_driver: {publishes: {gps: []}, host: other}
"""


@pytest.mark.parametrize(
    ("seen", "blamed"),
    [
        (["not ok(load,pc)", "not ok(image)", "not ok(map)"], [{"pc"}]),
        (["ok(load,pc)", "not ok(image)", "not ok(map)"], [{"camera"}, {"cam"}]),
        (["not ok(map)", "ok(image)"], [{"pc"}, {"slam"}]),
        (["not ok(load,pc)", "not ok(gps)"], [{"pc", "gps_driver"}]),
        (["ok(load,pc)", "ok(image)"], [set()]),
    ],
)
def test_what_is_late_on_an_overloaded_computer_is_the_fault_of_the_computer(
    seen: list[str], blamed: list[set[str]]
) -> None:
    system = load_text("robomend: 1\nname: r\n" + LOADED)
    observed = [literal for text in seen for literal in parse(text, system.vocabulary)]
    found = make_engine("sat", system.cnf).diagnose(observed)
    assert {frozenset(one.bad) for one in found.diagnoses} == {frozenset(one) for one in blamed}
