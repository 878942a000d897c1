"""`model check`: rules that cannot all hold are told with their lines."""

from __future__ import annotations

from robomend.model.checking import check
from robomend.model.loading import load_text

ROBOT = """\
robomend: 1
hardware: {base: {channel: 1}}
nodes: {driver: {drives: [base], publishes: {odom: []}}}
rules:
"""


def doubts(*rules: str) -> list[str]:
    text = ROBOT + "".join(f"  - '{rule}'\n" for rule in rules)
    return [warning for warning in check(load_text(text)) if "contradict" in warning]


def test_rules_that_contradict_one_another_are_named_with_their_lines_and_nothing_else() -> None:
    (warning,) = doubts("ok(odom) -> on(base)", "not ab(base) or ab(base)", "ok(odom)", "not on(base)")
    assert warning.startswith("no diagnosis will ever be found")
    assert warning.endswith(
        "ok(odom) -> on(base) (user rule 1, line 5); ok(odom) (user rule 3, line 7); "
        "not on(base) (user rule 4, line 8)"
    )


def test_rules_that_no_healthy_robot_fulfils_are_named() -> None:
    (warning,) = doubts("not on(base)")
    assert warning.startswith("no robot will ever be healthy")
    assert warning.endswith("not ab(base) -> on(base) (scheme 1, line 2); not on(base) (user rule 1, line 5)")


IDLE = """\
robomend: 1
hardware:
  base: {channel: 1}
  psu: {channel: 2}
  arm: {channel: 3, fed_by: [psu]}
  lamp: {channel: 4}
  blamed: {channel: 5}
nodes: {driver: {drives: [base], publishes: {odom: []}}}
topics: {odom: {}, battery: {}, spare: {}}
properties: [temperature, humidity, noise]
values:
  turn: {topic: odom, field: z}
  yaw: {topic: odom, field: w}
  pitch: {topic: odom, field: y}
related: [[turn, yaw]]
rules:
  - 'ok(battery) -> not ab(blamed)'
  - 'not ab(base) -> ok(temperature, base)'
  - 'not ab(base) -> ok(noise)'
"""


def test_what_is_declared_and_that_nothing_speaks_of_is_named_and_no_more() -> None:
    """What a rule mentions is spoken of, as are a property of one component, a related value, a feeder."""
    assert list(check(load_text(IDLE))) == [
        "topic spare: no node publishes it, and no rule mentions it",
        "property humidity: no rule mentions ok(humidity), so observing it says nothing",
        "value pitch: no related pair and no rule mentions it",
        "hardware arm: no node drives it, and no rule mentions it",
        "hardware lamp: no node drives it, and no rule mentions it",
    ]


def test_priors_of_some_components_only_are_doubtful() -> None:
    some = ROBOT.removesuffix("rules:\n").replace("channel: 1}", "channel: 1, prior: 0.1}")
    assert list(check(load_text(some))) == [
        "1 of 2 components have no prior (driver): a diagnosis that blames one has no probability"
    ]
    assert list(check(load_text(some.replace("drives:", "prior: 0.2, drives:")))) == []
    assert list(check(load_text(ROBOT.removesuffix("rules:\n")))) == []
