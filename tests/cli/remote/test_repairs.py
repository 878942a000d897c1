"""`robomend repairs`, `approve`, `cancel` and `stop` on a real repair."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.cli.remote.conftest import Say, Shared, answer, narrow
from tests.waiting import until


def test_a_repair_is_listed_told_approved_and_cancelled_and_a_late_click_is_told(
    say: Say, shared: Shared, robot: str
) -> None:
    repair = shared.awaiting_approval(robot)

    for arguments in (["--robot", robot], ["--open"], []):
        code, out, _ = say("repairs", *arguments)
        assert code == 0
        assert narrow(out)
        assert f"{repair}  {robot}" in out
        assert "awaiting-approval" in out

    _, told, _ = say("repairs", repair)
    assert narrow(told)
    assert f"repair {repair} of {robot} begins" in told
    assert "  chosen: hokuyo_node: " in told
    assert told.endswith(f"yes: robomend approve {repair}; no: robomend cancel {repair}\n")
    assert answer(say("repairs", repair, "--format", "json"))["account"]

    code, out, _ = say("approve", repair, "--reason", "looks right")
    assert code == 0
    assert out.startswith(f"approved: repair {repair} of {robot}\n  Stop hokuyo_node\n")
    until(lambda: shared.client.repair(repair)["state"] != "awaiting-approval", "the yes is heard")
    code, out, err = say("approve", repair)
    assert (code, out) == (1, "")
    assert err.startswith(f"too late: repair {repair} ")

    assert answer(say("cancel", repair, "--reason", "enough", "--format", "json"))["id"] == repair
    until(lambda: shared.client.repair(repair)["finished_ns"], "it has ended")
    code, _, err = say("cancel", repair)
    assert code == 1
    assert err == f"too late: repair {repair} has ended already (cancelled)\n"
    assert repair not in say("repairs", "--open")[1]
    noted = {(entry["action"], entry["reason"]) for entry in shared.client.audit(robot)["items"]}
    assert {reason for _, reason in noted} >= {"looks right", "enough"}


def test_a_repair_is_begun_by_hand_and_one_at_a_time(say: Say, shared: Shared, robot: str) -> None:
    shared.cancelled(robot)
    code, out, _ = say("repair", robot, "--bad", "hokuyo_node", "--reason", "now I am there")
    assert code == 0
    begun = out.split()[2]
    assert out == f"begun: repair {begun} of {robot}\nfollow it: robomend watch {robot}\n"
    code, out, err = say("repair", robot)
    assert (code, out) == (1, "")
    assert err.startswith("not begun: ")
    noted = {(entry["action"], entry["reason"]) for entry in shared.client.audit(robot)["items"]}
    assert ("repair.create", "now I am there") in noted
    say("cancel", begun)
    code, _, err = say("repair", robot, "--bad", "hokuyo_nod")
    assert code == 2
    assert "hokuyo_nod" in err


def test_without_repairs_that_is_said(say: Say, shared: Shared, robot: str) -> None:
    shared.robot(robot)
    assert say("repairs", "--robot", robot) == (0, "no repairs yet\n", "")
    assert say("repairs", "--robot", robot, "--open") == (0, "no repair is open\n", "")


def test_one_repair_and_a_list_are_two_questions(say: Say, robot: str) -> None:
    code, _, err = say("repairs", "r-1", "--robot", robot)
    assert code == 2
    assert "not both" in err


@pytest.fixture
def lifted(shared: Shared) -> Iterator[None]:
    yield
    shared.client.resume("the test is over")


@pytest.mark.usefixtures("lifted")
def test_the_stop_is_set_shown_and_lifted_for_a_reason(say: Say, shared: Shared, robot: str) -> None:
    shared.robot(robot)
    free = "no stop is set: robots may act, as their policies say\n"
    assert say("stop", "show") == (0, free, "")
    code, out, _ = say("stop", "--reason", "lunch")
    assert code == 0
    assert out.startswith("STOPPED by local at ")
    assert " UTC: lunch; no robot acts" in out  # "not on disk yet" may follow, on a busy machine
    assert answer(say("stop", "show", "--format", "json"))["active"]
    for arguments in (["status"], ["status", robot]):
        assert "STOPPED by local" in say(*arguments)[1]
    code, _, err = say("stop", "lift")
    assert code == 2
    assert "say why robots may act again" in err
    assert shared.client.stopped()["active"]
    assert say("stop", "lift", "--reason", "back again")[0] == 0
    until(lambda: say("stop", "show")[1] == free, "the stop is lifted on disk")
    reasons = [entry["reason"] for entry in shared.client.audit(limit=5)["items"]]
    assert "back again" in reasons
