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


def test_rules_that_a_healthy_robot_fulfils_are_no_contradiction() -> None:
    assert doubts("ab(base) -> not on(base)", "ok(odom) -> on(base)") == []
