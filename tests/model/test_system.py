"""What a robot or a question makes of a model."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from robomend.errors import UnknownComponent
from robomend.model.loading import load_text
from robomend.model.system import variant
from robomend.observations.language import read_assertion

ROBOT = replace(
    load_text("robomend: 1\nname: r\nnodes: {a: {publishes: {t: []}}, b: {publishes: {u: []}}}\n"),
    warnings=("mind the gap",),
)
EITHER = read_assertion("said", "ok(t) or ok(u)", ROBOT.vocabulary)
BOTH = read_assertion("said", "ok(t) and ok(u)", ROBOT.vocabulary)


def test_what_travels_to_a_worker_arrives_whole() -> None:
    there = pickle.loads(pickle.dumps(ROBOT.extended([EITHER])))
    assert there == ROBOT.extended([EITHER])
    assert there.cnf.puts_out == ROBOT.cnf.puts_out != {}
    assert str(there.cnf.rules) == str(ROBOT.extended([EITHER]).cnf.rules)


def test_equal_versions_are_equal_clauses() -> None:
    assert variant("v") == "v"
    versions = [
        variant("v"),
        variant("w"),
        variant("v", [EITHER]),
        variant("v", [BOTH]),
        variant("v", [EITHER, BOTH]),
        variant("v", (), ["a"]),
        variant("v", (), ["b"]),
        variant("v", [EITHER], ["a"]),
    ]
    assert len(set(versions)) == len(versions)
    assert variant("v", [EITHER], ["a", "b"]) == variant("v", [EITHER], ["b", "a"])


def test_components_are_named_as_the_model_writes_them() -> None:
    assert ROBOT.named(["/b", "a", "b"]) == ("b", "a", "b")
    with pytest.raises(UnknownComponent, match="no component is named 'c'"):
        ROBOT.named(["a", "c"])
