"""What a first model asks, and answers that become lines of it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.model.test_from_graph import came, heard

from robomend.errors import InputError
from robomend.model.answers import (
    GivenAnswers,
    answered,
    answers_of,
    asks_of_arrow,
    questions_of,
    with_answers,
)
from robomend.model.from_graph import arrow_question, first_model, steady
from robomend.model.loading import load_text
from robomend_client.observers import SECOND
from robomend_client.ros_graph import Learned

ODD = '/odd: "name"'
NODES: dict[str, tuple[list[str], list[str]]] = {
    "/camera": (["/image"], []),
    "/lidar_driver": (["/scan"], []),
    "/base_driver": (["/odom"], ["/cmd_vel"]),
    ODD: (["/odd"], []),
    "/mapper": (["/map", "/pose"], ["/scan"]),
    "/mission": (["/cmd_vel"], ["/pose"]),
}
TOPICS = {f"/{name}": came(10) for name in ("image", "scan", "odom", "odd", "pose")}
SILENT = "rear was silent all the time: is that so by design?"


def text() -> str:
    """A model of a robot with a silent sensor."""
    nodes = {**NODES, "/rear_driver": (["/rear"], [])}
    return first_model(heard(TOPICS, nodes, types={"/rear": "sensor_msgs/LaserScan"}), "rover").text


def test_who_rests_on_nobody_may_drive_a_device() -> None:
    asked = questions_of(text())
    assert asked.seconds == 60
    assert asked.drivers == {
        "base_driver": "base",
        "camera": "camera_device",
        "lidar_driver": "lidar",
        'odd: "name"': 'odd: "name"_device',
    }
    assert asked.others == (SILENT,)


def test_an_answer_is_a_line_and_the_device_is_blamed_beside_its_driver() -> None:
    model = answered(text(), "lidar_driver", "lidar, lidar_supply")
    model = answered(model, "camera", "")
    model = answered(model, SILENT, "yes")
    parts = load_text(model).parts
    assert parts is not None
    assert parts.nodes["lidar_driver"].drives == ("lidar", "lidar_supply")
    assert parts.nodes["camera"].drives == ()
    assert parts.hardware["lidar"].blame
    assert set(questions_of(model).drivers) == {"base_driver", 'odd: "name"'}
    assert questions_of(model).others == ()
    assert f"#   {SILENT} yes\n" in model
    with pytest.raises(InputError, match="does not ask that"):
        answered(model, "camera", "camera_device")


@pytest.mark.parametrize(
    ("question", "answer", "why"),
    [
        ("mapper", "lidar", "does not ask that"),
        ("nobody", "", "does not ask that"),
        (SILENT, "perhaps", "yes or no"),
        ("camera", "a\nb", "printable"),
        ("camera", "x" * 201, "printable"),
    ],
)
def test_what_was_not_asked_is_not_answered(question: str, answer: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        answered(text(), question, answer)


def inputs(text: str, node: str, topic: str) -> tuple[str, ...]:
    parts = load_text(text).parts
    assert parts is not None
    return parts.nodes[node].publishes[topic]


def test_an_arrow_that_was_contradicted_is_taken_out_or_kept_and_a_model_made_anew_follows() -> None:
    question = arrow_question("pose", "scan")
    first = text()
    assert inputs(first, "mapper", "pose") == ("scan",)
    assert asks_of_arrow(first, "pose", "scan")
    for answer, left in (("no", ()), ("yes", ("scan",))):
        model = answered(first, question, answer)
        assert inputs(model, "mapper", "pose") == left
        assert not asks_of_arrow(model, "pose", "scan")
        assert with_answers(first, answers_of(model)) == model
        assert questions_of(model) == questions_of(first)
        with pytest.raises(InputError, match="does not ask that"):
            answered(model, question, answer)
    with pytest.raises(InputError, match="yes or no"):
        answered(first, question, "perhaps")
    with pytest.raises(InputError, match="does not ask that"):
        answered(first, arrow_question("map", "scan"), "no")  # nothing says so
    by_hand = "robomend: 1\nnodes: {a: {publishes: {scan: []}}, mapper: {publishes: {pose: [scan]}}}\n"
    assert not asks_of_arrow(by_hand, "pose", "scan")  # its lines are its writer's


def test_an_arrow_that_was_seen_from_times_alone_is_asked_of_and_is_taken_out_by_a_no() -> None:
    nodes: dict[str, tuple[list[str], list[str]]] = {
        "/lidar": (["/scan"], []),
        "/mapper": (["/map"], ["/scan"]),
    }
    rates = {topic: steady(came(10), 60 * SECOND) for topic in ("/scan", "/map")}
    learned = Learned(rates, {"/map": {"/scan": "comes 20 ms after scan"}})
    first = first_model(heard({}, nodes, learned=learned), "rover").text
    assert "map: [scan]    # comes 20 ms after scan" in first
    question = arrow_question("map", "scan")
    assert question in questions_of(first).others
    model = answered(first, question, "no")
    assert inputs(model, "mapper", "map") == ()
    assert question not in questions_of(model).others
    assert with_answers(first, answers_of(model)) == model
    assert inputs(answered(first, question, "yes"), "mapper", "map") == ("scan",)


def test_a_model_by_hand_asks_nothing() -> None:
    assert not questions_of("robomend: 1\nnodes:\n  camera:\n    # drives: []\n    publishes: {image: []}\n")


@given(
    st.dictionaries(st.sampled_from(sorted(questions_of(text()).drivers)), st.sampled_from(("", "d", "e,f"))),
    st.sampled_from(("", "yes", "no")),
)
def test_a_model_that_is_made_anew_takes_the_answers_over(drives: dict[str, str], other: str) -> None:
    model = text()
    for number, (node, devices) in enumerate(drives.items()):
        names = ", ".join(f"{name.strip()}{number}" for name in devices.split(",") if name)
        model = answered(model, node, names)
    if other:
        model = answered(model, SILENT, other)
    load_text(model)
    assert with_answers(text(), answers_of(model)) == model
    assert with_answers(model, answers_of(model)) == model
    assert with_answers(model, GivenAnswers()) == model
