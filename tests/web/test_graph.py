"""The component graph: where things stand, and what is drawn of them."""

from __future__ import annotations

from robomend.model.components import ComponentModel
from robomend.model.loading import load_text
from robomend.resources import resource
from robomend.web.graph import BOX, Thing, layout, path, svg
from robomend.web.suspicion import Suspicion, suspicions


def model(text: str) -> ComponentModel:
    """Return a model of these lines."""
    parts = load_text("robomend: 1\nname: m\n" + text).parts
    assert parts is not None
    return parts


def test_everything_stands_right_of_what_it_rests_on() -> None:
    parts = load_text(resource("examples", "tedusar.yaml").read_text()).parts
    assert parts is not None
    drawn = layout(parts)
    assert all(drawn.places[source][0] < drawn.places[target][0] for source, target in drawn.edges)
    assert len(set(drawn.places.values())) == len(drawn.places), "one thing in each place"
    assert {thing.name for thing in drawn.places if thing.kind != "topic"} == set(parts.components)


def test_boxes_are_as_wide_as_the_longest_name_and_no_wider_than_can_be_read() -> None:
    short, long, endless = (
        layout(model(f"nodes:\n  {name}: {{}}\n")).box for name in ("a", "laser_alignment_control", "m" * 200)
    )
    assert BOX[0] == short < long < endless == BOX[1]
    drawn = svg(layout(model("nodes:\n  laser_alignment_control: {}\n")), {}, {}, {})
    assert ">laser_alignment_control<" in drawn


def test_a_circle_of_topics_is_drawn_all_the_same() -> None:
    parts = model(
        "nodes:\n  a: {publishes: {x: [y]}}\n  b: {publishes: {y: [x]}}\n  c: {publishes: {z: [z]}}\n"
    )
    drawn = layout(parts)
    assert len(drawn.places) == 6
    assert len(drawn.edges) == 6
    assert len(set(drawn.places.values())) == 6


def test_a_model_without_nodes_has_a_graph() -> None:
    parts = model("hardware:\n  psu: {}\n  lamp: {fed_by: [psu]}\n")
    drawn = layout(parts)
    assert drawn.places[Thing("hardware", "psu")][0] < drawn.places[Thing("hardware", "lamp")][0]


def test_the_way_from_a_cause_to_its_symptoms_is_marked_and_nothing_else() -> None:
    parts = model(
        "hardware:\n  d: {channel: 1}\n  e: {channel: 2}\nnodes:\n"
        "  n: {drives: [d], publishes: {t: [], w: []}}\n"
        "  m: {publishes: {u: [t]}}\n  k: {drives: [e], publishes: {v: []}}\n"
    )
    found = {"d": Suspicion("bad", 1.0), "k": Suspicion("suspect", 0.3)}
    drawn = layout(parts)
    on = path(drawn, found, {"u": False, "v": True})
    assert {thing.name for thing in on} == {"d", "n", "t", "m", "u"}
    assert svg(drawn, found, {"u": False, "v": True}, {}).count(" path") == 4
    assert path(drawn, found, {"u": True}) == frozenset()


def test_suspicion_is_the_probability_or_the_part_of_the_diagnoses() -> None:
    def result(*found: tuple[list[str], float | None]) -> dict[str, object]:
        return {"diagnoses": [{"bad": bad, "good": [], "probability": p} for bad, p in found]}

    names = ("a", "b", "c")
    assert suspicions(names, None)["a"] == Suspicion("unknown")
    even = suspicions(names, result((["a"], None), (["a", "b"], None)))
    assert even == {"a": Suspicion("bad", 1.0), "b": Suspicion("suspect", 0.5), "c": Suspicion("good")}
    weighed = suspicions(names, result((["a"], 0.6), (["b"], 0.2)))
    assert [round(weighed[name].share, 2) for name in names] == [0.75, 0.25, 0]
    assert suspicions(names, result(([], None)))["a"] == Suspicion("good")
