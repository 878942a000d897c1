"""The record of a repair in words: what was seen and when, why this and not that, what was done, and then."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import Robot, robot_of, the_repair

from robomend.diagnosis.result import Conflict, Diagnosis, DiagnosisResult
from robomend.entry import Entry
from robomend.planning.choice import Candidate, choose
from robomend.planning.plan import Outcome, Plan
from robomend.repairs.account import MOST, account, grounds, not_chosen, outcome
from robomend_client.literals import fails, holds
from robomend_client.readings import Symptom

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


def test_that_a_value_that_rises_does_not_fall_is_no_symptom_and_that_it_stands_still_is() -> None:
    entries = [Entry(fails(trend, "stamp"), "agent", 9, None, 8, 4) for trend in ("inc", "dec")]
    conflict = Conflict(("a",), (fails("inc", "stamp"), holds("ok", "t")), (), "")
    result = DiagnosisResult(("a",), (Diagnosis(("a",)),), True, None, (conflict,), 0.0)
    found = grounds(result, choose([Candidate(Diagnosis(("a",)), NO_PLAN)]), entries)
    assert [one["literal"] for one in found["symptoms"]] == ["not inc(stamp)"]
    assert outcome({"symptoms": []}, {entry.atom: entry for entry in entries}) == []


def test_the_outcome_names_what_does_not_hold_and_was_no_symptom_when_the_round_began() -> None:
    """A mute successor: its predecessor did not run, it runs, and says nothing."""
    round_ = {"symptoms": [{"literal": "not running(driver)"}]}
    entries = [
        Entry(holds("running", "driver"), "agent", 9, None, 5),
        Entry(fails("ok", "scan"), "agent", 9, None, 8, 4),
        Entry(holds("ok", "odom"), "agent", 9, None, 8),
    ]
    found = outcome(round_, {entry.atom: entry for entry in entries})
    assert [one["literal"] for one in found] == ["running(driver)", "not ok(scan)"]
    many = [Entry(fails("ok", f"t{n}"), "agent", 9, None, 8, 4) for n in range(30)]
    assert len(outcome(round_, {entry.atom: entry for entry in many})) == MOST


def lines_of(*rounds: dict[str, Any]) -> list[str]:
    return account({**REPAIR, "rounds": list(rounds)})


def test_what_was_so_before_is_told_with_the_evidence_from_after_the_acts() -> None:
    def seen(literal: str, since_ns: int, onset_ns: int | None) -> str:
        after = [{"literal": literal, "since_ns": since_ns, "onset_ns": onset_ns}]
        (line,) = [one for one in lines_of({**ROUND, "after": after}) if "seen after it" in one]
        return line.strip()

    anew = "seen after it: scan is as it should be since 00:00:02.000, and anew since 00:00:09.000"
    assert seen("ok(scan)", 9 * S, 2 * S) == anew
    assert seen("ok(scan)", 9 * S, 8 * S) == "seen after it: scan is as it should be since 00:00:08.000"
    assert (
        seen("not ok(scan)", 9 * S, 2 * S) == "seen after it: scan is not as it should be since 00:00:02.000"
    )
    assert (
        seen("ok(scan)", 3 * S, 2 * S) == "seen after it: scan is as it should be since 00:00:02.000"
    )  # nobody looked since


S = 10**9
STEP = {
    "text": "start_node(driver)",
    "name": "start_node",
    "parameters": ["driver"],
    "cost": 4.0,
    "sent_ns": 6 * S,
    "ended_ns": 11 * S,
    "state": "failed",
}
ROUND = {
    "began_ns": 5 * S,
    "diagnosis": {"bad": ["driver"], "good": []},
    "why": "driver: helps with probability 1 at cost 4",
    "plan": [
        {**STEP, "message": "… not seen within 5 s", "seen": ["running(driver)"], "missing": ["ok(scan)"]}
    ],
    "ending": "effect-missing",
    "reason": "start_node(driver) answered 'done', but ok(scan) was not seen within 5 s",
    "helped": False,
    "after": [{"literal": "running(driver)", "since_ns": 10 * S, "onset_ns": 7 * S}],
}
REPAIR = {
    "id": "r-1",
    "robot": "r1",
    "created_ns": S,
    "updated_ns": 12 * S,
    "finished_ns": 12 * S,
    "state": "escalated",
    "reason": "as the test says",
    "waiting_for": [],
}


def test_each_round_has_its_time_and_what_was_waited_for_before_it() -> None:
    waits = [
        {"from_ns": 2 * S, "until_ns": 5 * S, "round": 1, "why": "for observers", "names": ["ok(scan)"]},
        {
            "from_ns": 11 * S,
            "until_ns": None,
            "round": 2,
            "why": "until ok(scan) is seen",
            "names": ["ok(scan)"],
        },
    ]
    told = account({**REPAIR, "rounds": [ROUND], "waits": waits})
    assert told == [
        "00:00:01.000 repair r-1 of r1 begins",
        "00:00:02.000 waiting for observers: scan ok, for 3.0 s",
        "00:00:05.000 round 1: driver blamed",
        "  chosen: driver: helps with probability 1 at cost 4",
        "  Start driver: sent 00:00:06.000, ended 00:00:11.000, effect missing "
        "(its action answered 'done'); seen: driver running; not seen: scan ok",
        "  seen after it: driver is running since 00:00:07.000",  # not since its newest evidence
        "  it did not help: starting driver answered 'done', but scan ok was not seen within 5 s",
        "00:00:11.000 waiting until scan ok is seen: scan ok",
        "00:00:12.000 escalated: as the test says",
    ]


@pytest.mark.parametrize(
    ("ending", "helped", "words"),
    [
        ("done", True, "it helped: as it was"),
        ("done", False, "it did not help: as it was"),
        (
            "mismatch",
            True,
            "it helped, as nothing blames driver any more, and was not done to its end: as it was",
        ),
        ("mismatch", False, "it did not help: as it was"),
    ],
)
def test_whether_a_round_helped_and_whether_it_was_done_are_two_things(
    ending: str, helped: bool, words: str
) -> None:
    done = {**ROUND, "ending": ending, "helped": helped, "reason": "as it was"}
    assert account({**REPAIR, "rounds": [done]})[-2] == f"  {words}"
    done["by_itself"] = "ok(scan): not seen to be back"
    nobody = "  well again, and credited to nobody: scan ok: not seen to be back"
    assert account({**REPAIR, "rounds": [done]})[-2] == nobody


@pytest.mark.anyio
async def test_a_repair_tells_symptoms_conflicts_rivals_acts_and_what_was_seen_after_them(
    tmp_path: Path,
) -> None:
    async with robot_of(tmp_path) as (runtime, robot):
        robot.connected["lidar_node"] = False  # silent: the device or its driver
        repair = await the_repair(runtime)
        told = (await runtime.repairs.repair(repair["id"]))["account"]
    assert repair["state"] == "repaired", repair["reason"]
    text = "\n".join(told)
    assert told[0].endswith(f"repair {repair['id']} of r1 begins")
    assert " round 1: lidar_node blamed (perhaps)" in text
    assert "  symptom scan is " in text
    assert "  conflict: " in text
    assert "  not chosen: lidar: helps with probability 0.75 at cost 29; dearer than 4" in text
    assert "  Start lidar_node: sent " in text
    assert "  seen after it: scan is as it should be" in text
    assert "  it helped" in text
    assert f" repaired: {repair['reason']}" in told[-1]


def test_a_rival_that_lost_on_a_tie_is_told_as_that() -> None:
    done = {"weight": 0.5, "plan": [{"cost": 29.0}]}
    rival = {"bad": ["hub"], "why": "hub: helps with probability 0.5 at cost 29", "weight": 0.5, "helps": 0.5}
    told = "not chosen: hub: helps with probability 0.5 at cost 29"
    assert not_chosen({**rival, "cost": 29.0}, done) == f"{told}; as good"
    assert not_chosen({**rival, "cost": 30.0}, done) == f"{told}; dearer than 29"
    assert not_chosen({**rival, "cost": 28.0}, done) == told
    # It may help more probably than what was chosen: a cycle restarts the driver, too.
    likelier = {**rival, "cost": 30.0, "helps": 0.95, "weight": 0.1}
    assert not_chosen(likelier, done).endswith("; a less probable cause, and dearer than 29")
    assert not_chosen({**likelier, "cost": 29.0}, done).endswith("; a less probable cause")


def test_a_repair_that_contradicted_an_arrow_says_so(tmp_path: Path) -> None:
    async def cured(robot: Robot, name: str, _: str) -> None:
        if name == "start_node":
            robot.broken_topics.clear()

    async def test() -> dict[str, Any]:
        async with robot_of(tmp_path) as (runtime, robot):
            robot.kinds, robot.spoil = {"ok(scan)": Symptom.SILENT}, cured
            robot.onsets = {"not ok(scan)": time.time_ns() - 5 * 10**9}
            robot.broken_topics.add("scan")  # and the map goes on
            return await the_repair(runtime)

    repair = asyncio.run(test())
    assert repair["state"] == "repaired"
    text = "mapping was healthy without scan: that map rests on it may be wrong"
    assert repair["doubts"] == [{"node": "mapping", "topic": "map", "input": "scan", "text": text}]
    assert text in account(repair)
