"""What is told of a robot in words, and whether following them splits what could not be told apart."""

from __future__ import annotations

import pytest

from robomend.diagnosis.isolability.analysis import Ambiguity, Isolability, isolability
from robomend.diagnosis.isolability.words import sentences, suggestions, watched
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend_client.literals import Atom, parse_atom

CAMERA = """\
robomend: 1
name: camera_robot
hardware:
  camera: {channel: 4}
  lidar: {}
nodes:
  camera_driver: {drives: [camera], publishes: {image: []}}
  lidar_driver: {drives: [lidar], publishes: {scan: []}}
  detector: {publishes: {objects: [image]}}
topics:
  image: {cost: 2}
values:
  pan: {topic: image, field: pan}
  range: {topic: scan, field: range}
rules: [RULES]
related: [RELATED]
"""


def robot(rules: str = "", related: str = "") -> System:
    return load_text(CAMERA.replace("RULES", rules).replace("RELATED", related))


def asked(system: System, *observed: str) -> Isolability:
    return isolability(system.cnf, [parse_atom(atom) for atom in observed])


def group_of(found: Isolability, name: str) -> Ambiguity:
    groups = (*found.ambiguities, *found.undetectable)
    return next(group for group in groups if (name,) in group.faults)


def test_what_cannot_be_told_apart_is_told_with_what_to_watch() -> None:
    system = robot()
    found = asked(system, "ok(image)", "running(camera_driver)", "ok(objects)")
    words = "camera cannot be told from camera_driver: watch whether camera is on (channel 4); 1 s"
    assert words in sentences(found, system)


def test_the_whole_is_told_first_with_how_many_faults_there_are_to_tell() -> None:
    first, *_ = sentences(asked(robot(), "ok(image)", "running(camera_driver)", "ok(objects)"), robot())
    said = "3 of 5 single faults can be detected by 3 observables: "
    assert first.startswith(said)
    nothing, *_ = sentences(asked(robot(), "running(lidar_driver)"), robot())
    assert (
        "1 of 5 single faults can be detected by 1 observable: 1 always told from every other fault, "
        in nothing
    )


@pytest.mark.parametrize(
    ("name", "observed"),
    [
        ("camera", ["ok(image)"]),
        ("camera_driver", ["ok(objects)"]),
        ("detector", ["ok(objects)", "running(camera_driver)"]),
        ("lidar_driver", ["ok(image)"]),
    ],
)
def test_watching_what_the_words_say_splits_the_group(name: str, observed: list[str]) -> None:
    system = robot()
    found = asked(system, *observed)
    group = group_of(found, name)
    assert group.further is not None
    assert group.further.atoms
    after = asked(system, *observed, *map(str, group.further.atoms))
    index = system.cnf.components.index(name)
    assert after.detectable[index]
    rivals = [after.faults.index(rival) for rival in (*group.faults, *group.rivals) if rival != (name,)]
    assert "-" not in {after.matrix[index][rival] for rival in rivals}


def test_a_rule_that_is_suggested_tells_a_fault_from_all_else() -> None:
    before = robot()
    seen = [str(atom) for atom in before.cnf.atoms]
    (suggestion,) = suggestions(group_of(asked(before, *seen), "lidar"), before)
    # It has no channel: nobody sees whether it is on.
    assert str(suggestion.watch) == "ok(self_test,lidar)"
    assert watched(suggestion.watch, before.parts).startswith("a self-test of lidar")
    after = robot(f'"{suggestion.add}"')
    found = asked(after, *seen, str(suggestion.watch))
    assert "-" not in found.matrix[after.cnf.components.index("lidar")]


def test_a_trend_that_is_suggested_tells_a_node_from_its_rivals() -> None:
    before = robot()
    found = asked(before, "ok(image)")
    trend = next(one for one in suggestions(group_of(found, "camera_driver"), before) if "related" in one.add)
    assert trend.add == "related: [[pan, range]]"
    after = robot(related="[pan, range]")
    index = after.cnf.components.index("camera_driver")
    rival = after.cnf.components.index("camera")
    assert found.matrix[index][rival] == "-"
    assert asked(after, "ok(image)", str(trend.watch)).matrix[index][rival] == "~"


def test_what_no_rule_speaks_of_is_named() -> None:
    system = robot()
    found = isolability(system.cnf, [Atom("ok", ("image",)), Atom("ok", ("CPU", "detector"))])
    assert "no rule mentions ok(CPU,detector): observing it adds nothing" in sentences(found, system)
