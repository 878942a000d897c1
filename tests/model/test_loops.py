"""Circles of topics: which there are, what their clause says, and that all engines read it alike."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.model.compiling import compile_robot
from robomend.model.components import ComponentModel, Node, Topic
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend.planning.prediction import theory_of
from robomend_client.literals import Atom, Literal, fails, holds

LOOP = load_text(
    "robomend: 1\n"
    "hardware: {gyro: {channel: 1}}\n"
    "nodes:\n"
    "  gyro_d: {drives: gyro, publishes: [rate]}\n"
    "  est: {publishes: {state: [rate, cmd]}}\n"
    "  ctl: {publishes: {cmd: [state]}}\n"
    "  view: {publishes: {img: [state]}}\n"
)
SILENT = (holds("ok", "rate"), fails("ok", "state"), fails("ok", "cmd"), fails("ok", "img"))


def bad_of(system: System, seen: tuple[Literal, ...], engine: str = "sat") -> set[tuple[str, ...]]:
    made = make_engine(engine, system.cnf)
    try:
        return {diagnosis.bad for diagnosis in made.diagnose(seen, Options(limit=None)).diagnoses}
    finally:
        made.close()


def up(system: System) -> System:
    """The system as it is for a robot on which all circles were up."""
    return system.extended(loop.clause for loop in system.loops)


def test_a_circle_has_its_members_its_devices_and_what_comes_from_outside() -> None:
    (loop,) = LOOP.loops
    assert (loop.topics, loop.members, loop.nested) == (("state", "cmd"), ("est", "ctl"), False)
    assert loop.clause.text == "not ab(est) and not ab(ctl) and ok(rate) -> ok(state) and ok(cmd)"


def test_a_hung_node_in_a_circle_that_was_up_is_a_diagnosis() -> None:
    assert bad_of(LOOP, SILENT) == {()}  # each waits for the other: nobody is to blame
    assert bad_of(up(LOOP), SILENT) == {("est",), ("ctl",)}


@st.composite
def circular(draw: st.DrawFn) -> tuple[ComponentModel, tuple[Literal, ...]]:
    """Up to five nodes that read anything, an input from outside, and what is seen of some topics."""
    topics = [f"t{index}" for index in range(draw(st.integers(2, 5)))]
    inputs = st.lists(st.sampled_from([*topics, "outside"]), unique=True, max_size=3)
    nodes = {
        f"n{index}": Node(f"n{index}", (), {topic: tuple(draw(inputs))}) for index, topic in enumerate(topics)
    }
    signs = draw(st.lists(st.sampled_from((True, False, None)), min_size=6, max_size=6))
    seen = tuple(
        Literal(Atom("ok", (topic,)), sign)
        for topic, sign in zip([*topics, "outside"], signs, strict=False)
        if sign is not None
    )
    return ComponentModel("r", {}, nodes, {"outside": Topic("outside")}), seen


@settings(max_examples=40, deadline=None)
@given(circular())
def test_all_engines_agree_and_every_mismatch_of_the_prediction_is_explained(
    drawn: tuple[ComponentModel, tuple[Literal, ...]],
) -> None:
    model, seen = drawn
    system = up(compile_robot(model))
    found = bad_of(system, seen)
    for engine in ("hs_dag", "maxsat"):
        assert bad_of(system, seen, engine) == found
    outside = [literal for literal in seen if literal.atom == Atom("ok", ("outside",))]
    expected = theory_of(system.cnf).derived(system.cnf.components, outside)
    if any(-literal in expected for literal in seen):
        assert () not in found


@pytest.mark.parametrize("engine", ["asp"])
def test_the_encoding_in_answer_set_programming_agrees(engine: str) -> None:
    assert bad_of(up(LOOP), SILENT, engine) == {("est",), ("ctl",)}
