"""Paths into messages of mappings and lists, as those of the bus are."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomend_client.observers.kinds import read_observers
from robomend_client.paths import NotThere, at
from robomend_client.yaml_reader import ConfigError, read

MESSAGE = {
    "twist": {"angular": {"z": 0.5}},
    "ranges": [1.0, 2.0, 3.0],
    "names": ["laser", "arm"],
    "goals": [
        {"goal_id": {"id": "a.b", "stamp": 1}, "status": 3},
        {"goal_id": {"id": "c", "stamp": 2}, "status": 4},
    ],
    "empty": [],
}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("twist.angular.z", 0.5),
        ("ranges.1", 2.0),
        ("ranges[0]", 1.0),
        ("ranges[-1]", 3.0),
        ("ranges[-2:]", [2.0, 3.0]),
        ("ranges[:1]", [1.0]),
        ("names[-1]", "arm"),
        ("goals[-1].status", 4),
        ("goals[goal_id=a.b].status", 3),
        ("goals[goal_id.id=c].status", 4),
        ("goals[status=4].goal_id.id", "c"),
        ("goals[-5:].status", [3, 4]),
        ("twist.angular.z,goals[-1].status", {"twist.angular.z": 0.5, "goals[-1].status": 4}),
        ("empty[-3:]", []),
    ],
)
def test_a_path_leads_into_mappings_and_lists(path: str, value: object) -> None:
    assert at(MESSAGE, path) == value


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("twist.linear", "'linear' is not there"),
        ("ranges.3", "'3' is not there, the list has 3 elements"),
        ("empty[-1]", "the list has no elements"),
        ("goals.status", r"'status' is in a list: write \[0\], \[-1\] or \[key=value\] before it"),
        ("goals[status=5].status", r"no element has \[status=5\]"),
        ("twist[0]", "that is no list"),
        ("twist.angular.z.more", "'more' is not there"),
        ("ranges.__class__", "write"),
    ],
)
def test_what_is_not_there_is_named_with_the_step_that_failed(path: str, why: str) -> None:
    with pytest.raises(NotThere, match=why):
        at(MESSAGE, path)


def test_a_bad_path_is_a_mistake_in_the_file_with_its_place(tmp_path: Path) -> None:
    file = tmp_path / "agent.yaml"
    file.write_text('observers:\n  x: {kind: property, source: "motor:current[last]", high: 1}\n')
    with pytest.raises(
        ConfigError, match=r"agent.yaml:2: observers.x.source: .*\[last\] is no place of a list"
    ):
        read_observers(read(file), tmp_path)
