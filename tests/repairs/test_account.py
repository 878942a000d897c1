"""The record of a repair in words: what was seen and when, why this and not that, what was done, and then."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.repairs.robot import Robot, robot_on, running, service, the_repair

from robomend.diagnosis.result import Conflict, Diagnosis, DiagnosisResult
from robomend.entry import Entry
from robomend.planning.choice import Candidate, choose
from robomend.planning.plan import Outcome, Plan
from robomend.repairs.account import MOST, grounds, outcome
from robomend_client.literals import fails, holds

NO_PLAN = Plan(Outcome.UNSOLVABLE, (), 0.0, "asp", frozenset(), (), (), (), 0.0)


def test_grounds_are_bounded_and_symptoms_come_in_the_order_in_which_they_began() -> None:
    entries = [Entry(fails("ok", f"t{n}"), "agent", 100 + n, None, 90 + n, 200 - n) for n in range(30)]
    result = DiagnosisResult(("a",), (Diagnosis(("a",)),), True, None, (), 0.0)
    choice = choose([Candidate(Diagnosis(("a",)), NO_PLAN)])
    found = grounds(result, choice, [*entries, Entry(holds("ok", "x"), "agent", 1)])
    assert [one["literal"] for one in found["symptoms"]] == [
        f"not ok(t{n})" for n in range(29, 29 - MOST, -1)
    ]
    assert found["symptoms_left_out"] == 30 - MOST


def test_only_conflicts_that_the_choice_resolves_are_told() -> None:
    conflicts = tuple(
        Conflict((name,), (fails("ok", "t"),), (), f"conflict of {name}") for name in ("a", "b")
    )
    result = DiagnosisResult(("a", "b"), (Diagnosis(("a",)),), True, None, conflicts, 0.0)
    choice = choose([Candidate(Diagnosis(("a",)), NO_PLAN)])
    assert choice.diagnosis is None
    assert grounds(result, choice, [])["conflicts"] == []


def test_the_outcome_is_what_is_known_of_the_symptoms_then() -> None:
    round_ = {"symptoms": [{"literal": "not ok(scan)"}, {"literal": "not ok(map)"}]}
    entry = Entry(holds("ok", "scan"), "agent", 9, None, 5)
    assert outcome(round_, {entry.atom: entry}) == [{"literal": "ok(scan)", "since_ns": 5, "onset_ns": None}]


@pytest.mark.anyio
async def test_a_repair_tells_symptoms_conflicts_rivals_acts_and_what_was_seen_after_them(
    tmp_path: Path,
) -> None:
    async with service(tmp_path) as runtime:
        async with robot_on(runtime):
            pass  # it is configured
        robot = Robot(runtime.repairs, runtime.robots)
        async with running(robot):
            await robot.settled()
            robot.connected["lidar_node"] = False  # silent: the device or its driver
            repair = await the_repair(runtime)
            told = (await runtime.repairs.repair(repair["id"]))["account"]
    assert repair["state"] == "repaired", repair["reason"]
    text = "\n".join(told)
    assert told[0].endswith(f"repair {repair['id']} of r1 begins")
    assert "round 1: lidar_node blamed (weight 0.5)" in text
    assert "  symptom not ok(scan) since " in text
    assert "  conflict: " in text
    assert "  not chosen (weight 0.5): lidar: helps with probability 1 at cost 29; dearer, for 29" in text
    assert "  start_node(lidar_node): sent " in text
    assert "  seen after it: ok(scan) since " in text
    assert "  it helped" in text
    assert f" repaired: {repair['reason']}" in told[-1]
