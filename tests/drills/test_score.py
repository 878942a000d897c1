"""The score of drills: against what was promised, and against an earlier report."""

from __future__ import annotations

from typing import Any

import pytest

from robomend.drills.score import compared, passed, report, scored

PLANNED = {
    "kind": "node-killed",
    "component": "driver",
    "promise": "told",
    "shows": ["not ok(scan)", "not running(driver)"],
}


def drilled(**seen: Any) -> dict[str, Any]:
    """Return a drill as the service tells of it, watched to its end."""
    found = {
        "detected_s": 0.5,
        "diagnoses": [["driver"]],
        "showed": {"not ok(scan)": 0.4, "not running(driver)": 0.1},
        "acted_s": 0.6,
        "repair": "r-1",
        "repair_state": "repaired",
        "repair_reason": "",
        "repaired_s": 1.5,
        "acts": ["start_node(driver)"],
        "needless": [],
    }
    of = {"id": "d-1", "state": "done", "undone": True, "cut_short": None, "reason": ""}
    return {**of, "seen": {**found, **seen}}


def row(**seen: Any) -> dict[str, Any]:
    return scored(PLANNED, drilled(**seen))


@pytest.mark.parametrize(
    ("seen", "outcome"),
    [
        ({}, "told"),
        ({"diagnoses": [["lidar"], ["driver"]]}, "among"),
        ({"diagnoses": [["lidar"]]}, "missed"),
        ({"diagnoses": [["lidar", "driver"]]}, "missed"),
        ({"detected_s": None, "diagnoses": []}, "unseen"),
    ],
)
def test_an_outcome_has_the_words_of_a_promise_and_keeps_it_or_not(
    seen: dict[str, Any], outcome: str
) -> None:
    found = row(**seen)
    assert (found["outcome"], found["kept"]) == (outcome, outcome == "told")
    worst = scored({**PLANNED, "promise": "unseen"}, drilled(**seen))
    assert worst["kept"]


def test_the_observer_to_look_at_is_named_with_its_agent() -> None:
    planned = {**PLANNED, "observers": {"ok(scan)": "agent onboard"}}
    [what] = scored(planned, drilled(diagnoses=[["lidar"]], showed={"not running(driver)": 0.1}))["look_at"]
    assert what == "the observer of ok(scan) (agent onboard): `not ok(scan)` was to be seen, and was not"


def test_worse_than_promised_names_the_observer_that_was_slower_than_the_repair() -> None:
    late = {"not ok(scan)": 0.4, "not running(driver)": 2.0}
    [what] = row(diagnoses=[["lidar"], ["driver"]], showed=late)["look_at"]
    assert "the observer of running(driver)" in what
    assert "hold_s" in what


def test_worse_than_promised_names_the_rules_that_did_not_predict_what_was_seen() -> None:
    more = {"not ok(scan)": 0.4, "not running(driver)": 0.1, "not ok(map)": 0.3, "not ok(late)": 9.0}
    assert row(diagnoses=[["mapper"]], showed=more)["look_at"] == [
        "the rules about ok(map): `not ok(map)` was seen, and none predicts it of this fault"
    ]
    [what] = row(diagnoses=[["mapper"]])["look_at"]
    assert "--isolability" in what


def test_a_drill_that_was_cut_short_says_nothing_and_does_not_pass() -> None:
    cut = {**drilled(), "state": "cancelled", "cut_short": "the agent is gone"}
    rows = [row(), scored(PLANNED, cut), scored(PLANNED, None, "the robot is in use")]
    assert [one["outcome"] for one in rows] == ["told", None, None]
    assert [one["why_not"] for one in rows] == ["", "the agent is gone", "the robot is in use"]
    told = report("r1", rows, complete=True)
    assert (told["totals"]["faults"], told["totals"]["watched"]) == (3, 1)
    assert not passed(told)
    assert passed(report("r1", rows[:1], complete=True))


def against(then: dict[str, Any], now: dict[str, Any]) -> dict[str, list[str]]:
    return compared(report("r1", [now], complete=True), report("r1", [then], complete=True))


def test_reports_compare_fault_by_fault() -> None:
    among = row(diagnoses=[["lidar"], ["driver"]])
    assert against(row(), among)["worse"] == ["node-killed:driver: was told, is among"]
    assert against(among, row())["better"] == ["node-killed:driver: was among, is told"]
    unrepaired = row(repaired_s=None, repair_reason="it sticks")
    assert against(row(), unrepaired)["worse"] == ["node-killed:driver: was repaired, and is not: it sticks"]
    assert against(row(), row(needless=["x"]))["worse"] == ["node-killed:driver: 1 needless act more"]
    slow = against(row(), row(repaired_s=20.0))
    assert (slow["worse"], len(slow["slower"])) == ([], 1)
    gone = against(row(), scored(PLANNED, None, "it is in use"))
    assert "was told, and is not watched to its end: it is in use" in gone["worse"][0]
    other = scored({**PLANNED, "kind": "node-frozen"}, drilled())
    found = against(row(), other)
    assert (found["only_now"], found["only_then"]) == (["node-frozen:driver"], ["node-killed:driver"])
    same = against(row(), row())
    assert not any(same.values())


def test_what_is_no_report_is_refused() -> None:
    for last in ({}, {"robomend_drill": 2, "faults": []}, {"robomend_drill": 1}):
        with pytest.raises(ValueError, match="no report"):
            compared(report("r1", [], complete=True), last)
