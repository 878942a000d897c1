"""Which events people are told of, once each, and in which words."""

from __future__ import annotations

from typing import Any

import pytest

from robomend.notifications.notices import Notice, message, notice_of
from robomend.notifications.recipients import Recipient
from robomend_client.events import Event, Kind

WAITING: dict[str, Any] = {
    "id": "r-1",
    "robot": "r1",
    "state": "awaiting-approval",
    "round": 1,
    "diagnosis": {"bad": ["jaguar"], "good": []},
    "plan": [
        {"name": "power_up", "parameters": ["jaguar"], "text": "power_up(jaguar)", "state": "waiting"},
        {"name": "start_node", "parameters": ["j_node"], "text": "start_node(j_node)", "state": "waiting"},
    ],
    "rounds": [
        {
            "diagnosis": {"bad": ["jaguar"], "good": []},
            "weight": 1.0,
            "symptoms": [
                {
                    "literal": "not on(jaguar)",
                    "since_ns": 1_764_000_000 * 10**9,
                    "onset_ns": None,
                    "blames": ["jaguar"],
                }
            ],
        }
    ],
    "reason": "",
    "policy": "approve",
    "waiting_for": [],
    "created_ns": 1_764_000_000 * 10**9,
    "finished_ns": None,
}

ENDED = {"finished_ns": 1_764_000_001 * 10**9}


def event(kind: Kind, data: dict[str, Any], *, robot: str | None = "r1", number: int = 7) -> Event:
    return Event(number, 1_764_000_000_123_456_789, kind, robot, data)


def told(kind: Kind, data: dict[str, Any], **more: Any) -> Notice:
    notice = notice_of(event(kind, data, **more))
    assert notice is not None
    return notice


def test_a_plan_that_waits_for_a_yes_is_told_with_what_it_is_for() -> None:
    notice = told(Kind.REPAIR, WAITING)
    assert notice.about == "approval"
    assert notice.title == "r1: jaguar has no power since 16:00:00"
    assert notice.lines == (
        "Power up jaguar and start j_node?",
        "plan: Power up jaguar; Start j_node",
        "diagnosis: jaguar",
    )


def test_what_was_measured_of_the_newest_symptoms_is_told() -> None:
    symptoms = [
        {"literal": "not ok(scan)", "reading": {"value": 0, "text": "0 of 10 Hz for 2.1 s"}},
        {"literal": "not ok(map)"},
    ]
    first = WAITING["rounds"][0]
    notice = told(Kind.REPAIR, {**WAITING, "rounds": [first, {**first, "symptoms": symptoms}]})
    assert notice.lines[-1] == "seen: scan is not as it should be (0 of 10 Hz for 2.1 s)"


def test_the_same_plan_is_the_same_notice_and_another_one_is_another() -> None:
    key = told(Kind.REPAIR, WAITING).key
    assert told(Kind.REPAIR, {**WAITING, "updated_ns": 3}, number=9).key == key
    assert told(Kind.REPAIR, {**WAITING, "round": 2}).key != key
    assert told(Kind.REPAIR, {**WAITING, "plan": WAITING["plan"][:1]}).key != key
    assert told(Kind.REPAIR, {**WAITING, "reason": "did it arm?"}).key != key


def test_a_question_waits_for_an_answer() -> None:
    notice = told(Kind.REPAIR, {**WAITING, "plan": [], "reason": "did arm(gripper) act?"})
    assert notice.lines[0] == "A person is asked: did arm(gripper) act?"


@pytest.mark.parametrize("state", ["escalated", "failed"])
def test_a_repair_that_needs_a_person_is_told_once(state: str) -> None:
    notice = told(Kind.REPAIR, {**WAITING, **ENDED, "state": state, "reason": "every round was tried"})
    assert "A person is needed" in notice.lines[0]
    assert "every round was tried" in notice.lines[0]
    assert (notice.about, notice.key) == ("escalated", "escalated:r-1")
    assert notice.repair == "r-1"


def test_a_drill_is_told_of_only_where_a_person_is_needed() -> None:
    drill = {"id": "d-1", "state": "failed", "reason": "it is undone, and the robot is not healthy: base"}
    notice = told(Kind.DRILL, drill)
    assert (notice.about, notice.repair) == ("escalated", None)
    assert "base" in notice.lines[0]
    for other in ({"state": "done"}, {"state": "cancelled"}, {"asked": "abandon"}):
        assert notice_of(event(Kind.DRILL, {**drill, **other})) is None


def test_a_repair_of_a_planted_fault_asks_for_a_yes_and_needs_nobody_afterwards() -> None:
    assert told(Kind.REPAIR, {**WAITING, "drill": "d-1"}).about == "approval"
    for state in ("escalated", "failed"):
        assert notice_of(event(Kind.REPAIR, {**WAITING, "state": state, "drill": "d-1"})) is None


def test_a_robot_of_which_nothing_is_known_is_told() -> None:
    data = {"what": "health", "state": "unknown", "unknown": ["on(jaguar)", "ok(odom)"]}
    notice = told(Kind.ROBOT, data)
    assert (notice.about, notice.robot, notice.repair) == ("unknown", "r1", None)
    assert notice.title == "r1: Nothing is heard of it"
    assert notice.lines == (
        "A person is needed: are its agent and its network running?",
        "not observed: on(jaguar), ok(odom)",
    )


def test_of_a_robot_that_was_just_set_up_nobody_is_told() -> None:
    data = {"what": "health", "state": "unknown", "unknown": ["ok(odom)"], "reported": False}
    assert notice_of(event(Kind.ROBOT, data)) is None


@pytest.mark.parametrize(
    ("active", "title"), [(True, "the global stop was set"), (False, "the global stop was lifted")]
)
def test_the_stop_is_told_each_time(active: bool, title: str) -> None:
    data = {"active": active, "by": "ann", "reason": "smoke"}
    notice = told(Kind.STOP, data, robot=None)
    assert (notice.title, notice.lines) == (title, ("by: ann", "reason: smoke"))
    assert told(Kind.STOP, data, robot=None, number=8).key != notice.key


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        (Kind.REPAIR, {**WAITING, "state": "running"}),
        (Kind.REPAIR, {**WAITING, "asked": "approve", "asked_by": "ann"}),
        (Kind.ROBOT, {"what": "health", "state": "partly-unknown", "unknown": ["on(jaguar)"]}),
        (Kind.ROBOT, {"what": "updated"}),
        (Kind.DIAGNOSIS, {"healthy": False}),
    ],
)
def test_nobody_is_told_of_the_rest(kind: Kind, data: dict[str, Any]) -> None:
    assert notice_of(event(kind, data)) is None


def test_what_is_long_is_cut() -> None:
    plan = [{**WAITING["plan"][0], "parameters": [f"c{n}"]} for n in range(500)]
    notice = told(Kind.REPAIR, {**WAITING, "plan": plan, "reason": "x" * 5000})
    assert notice.lines[0] == "Power up c0, power up c1 and 498 more?"
    assert notice.lines[1].endswith("Power up c19; and 480 more")
    assert len(notice.lines[3]) < 1100


def test_a_message_leads_to_the_page_of_what_it_tells() -> None:
    sent = message(17, told(Kind.REPAIR, WAITING).data, "https://robots.example/")
    assert sent["url"] == "https://robots.example/ui/repairs/r-1"
    assert (sent["id"], sent["time"]) == ("n-17", "2025-11-24T16:00:00.123Z")
    unknown = told(Kind.ROBOT, {"what": "health", "state": "unknown"})
    assert message(1, unknown.data, "http://h:8600/x")["url"] == "http://h:8600/x/ui/robots/r1"
    assert message(1, unknown.data, None)["url"] is None


@pytest.mark.parametrize(
    ("about", "robots", "wanted"),
    [
        ({"approval"}, ("*",), True),
        ({"approval"}, ("r?",), True),
        ({"approval"}, ("lab-*", "r1"), True),
        ({"approval"}, ("lab-*",), False),
        ({"stop"}, ("*",), False),
    ],
)
def test_a_recipient_is_told_of_its_robots_and_subjects(
    about: set[str], robots: tuple[str, ...], wanted: bool
) -> None:
    recipient = Recipient("duty", None, ("a@b.example",), frozenset(about), robots)
    assert recipient.wants(told(Kind.REPAIR, WAITING)) == wanted


def test_the_stop_concerns_whoever_is_told_of_stops() -> None:
    recipient = Recipient("duty", None, ("a@b.example",), frozenset({"stop"}), ("lab-*",))
    assert recipient.wants(told(Kind.STOP, {"active": True}, robot=None))
