"""What an act may change: along the model's arrows, in circles too, and by the user's rules."""

from __future__ import annotations

from robomend.model.loading import load_text
from robomend.planning.influence import influenced, needed, touched
from robomend.planning.prediction import theory_of
from robomend_client.literals import Atom

MODEL = """
robomend: 1
name: arrows
hardware:
  supply: {channel: 1}
  lidar: {channel: 2, fed_by: [supply]}
  arm: {channel: 3}
nodes:
  driver: {drives: [lidar], publishes: {scan: []}}
  slam: {publishes: {map: [scan, pose]}}
  localizer: {publishes: {pose: [map]}}
  arm_driver: {drives: [arm], publishes: {joints: []}}
properties: [cpu]
rules:
  - not ab(slam) -> ok(cpu,slam)
"""


def test_what_rests_on_a_component_is_touched_circles_included() -> None:
    parts = load_text(MODEL).parts
    assert parts is not None
    assert touched(parts, ["driver"]) == {"driver", "scan", "map", "pose"}
    assert touched(parts, ["supply"]) == {"supply", "lidar", "scan", "map", "pose"}
    assert touched(parts, ["localizer"]) == {"localizer", "pose", "map"}
    assert touched(parts, ["arm_driver"]) == {"arm_driver", "joints"}


def test_what_a_topic_needs_is_found_against_the_arrows_circles_included() -> None:
    parts = load_text(MODEL).parts
    assert parts is not None
    assert needed(parts, ["map", "scan", "joints", "driver"]) == {
        "map": {"scan", "pose", "map"},
        "scan": set(),
        "joints": set(),
        "driver": set(),
    }


def test_a_rule_that_asks_for_what_is_only_observed_is_followed_to_what_it_concludes() -> None:
    rule = "  - not ab(arm_driver) and ok(lit) -> ok(sharp)\n"
    system = load_text(MODEL.replace("[cpu]", "[cpu, lit, sharp]") + rule)
    assert system.parts is not None
    lit, sharp = (Atom("ok", (name,)) for name in ("lit", "sharp"))
    theory = theory_of(system.cnf)
    assert influenced(system.parts, theory, ["arm_driver"], [lit, sharp]) == {sharp}
    assert influenced(system.parts, theory, ["slam"], [lit, sharp]) == frozenset()
