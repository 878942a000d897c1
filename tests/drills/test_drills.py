"""Drills on a robot of processes: planted, watched, undone; what stands in the way; what is remembered."""

from __future__ import annotations

import time

import pytest
from tests.drills.drilled_robot import DrilledRobot
from tests.waiting import until

from robomend_client.rest import ApiError


def refused(robot: DrilledRobot, fault: str, component: str) -> tuple[int, str]:
    with robot.client as client, pytest.raises(ApiError) as error:
        client.start_drill("r1", fault, component)
    return error.value.status, error.value.detail


@pytest.mark.parametrize(
    ("fault", "component", "act"),
    [
        ("node-killed", "mapping", "start_node(mapping)"),
        ("node-frozen", "mapping", "start_node(mapping)"),
        ("node-mute", "mapping", "start_node(mapping)"),
        ("device-off", "base", "power_up(base)"),
    ],
)
def test_a_fault_is_planted_seen_repaired_and_undone(
    robot: DrilledRobot, fault: str, component: str, act: str
) -> None:
    with robot.client as client:
        drill = robot.start_drill(fault, component)
        ended = robot.ended(drill["id"])
        assert (ended["state"], ended["undone"], ended["cut_short"]) == ("done", True, None), ended
        seen = ended["seen"]
        assert [component] in seen["diagnoses"]
        assert (seen["repair_state"], seen["needless"]) == ("repaired", [])
        assert act in seen["acts"]
        assert 0 <= seen["detected_s"] <= seen["repaired_s"]
        repair = client.repair(seen["repair"])
        assert repair["drill"] == drill["id"]
        assert client.drills("r1")["items"][0] == ended
        past = [line["data"] for line in client.history("r1", kind="diagnosis", limit=20)["items"]]
        at_fault = [one for one in past if component in str(one["result"]["diagnoses"])]
        assert drill["id"] in {one["drill"] for one in at_fault}
        if fault == "node-mute":  # another process stands in for it
            before = {text for text, at_s in seen["showed"].items() if at_s < seen["acted_s"]}
            assert "not running(mapping)" not in before
        told = []
        for event in client.events(robot="r1", after=0):
            if event.kind == "drill" and event.data["id"] == drill["id"]:
                told.append(event.data["state"])
                if event.data["finished_ns"] is not None:
                    break
        audit = client.audit("r1", limit=200)["items"]
    audited = [one["action"] for one in reversed(audit) if one["subject"] == drill["id"]]
    states = ["waiting", "planting", "planted", "undoing", "recovering", "done"]
    assert told == sorted(told, key=states.index)
    assert audited == ["drill.create", *(f"drill.{state}" for state in states[1:] if state in told)]
    if fault == "node-killed":
        assert set(told) == set(states)


# An agent that is starved calls messages that come seconds late unknown: they are delayed with --long, alone.
@pytest.mark.parametrize("fault", ["topic-dropped", pytest.param("topic-delayed", marks=pytest.mark.long)])
def test_a_topic_that_the_bus_loses_is_its_publishers_fault_and_passes_again_afterwards(
    robot: DrilledRobot, fault: str
) -> None:
    robot.configure(policy="approve")  # nothing that a repair does would help
    try:
        drill = robot.start_drill(fault, "lidar_node", bound_s=300.0, detect_s=200.0, topic="scan")
        until(lambda: ["lidar_node"] in robot.blamed(), "its publisher is blamed")
        assert "not ok(scan)" in robot.held()
        assert "not running(lidar_node)" not in robot.held()
        ended = robot.cancelled(drill["id"])
        assert (ended["undone"], ended["topic"]) == (True, "scan"), ended
    finally:
        robot.configure(policy="auto")
    robot.until_healthy()


@pytest.mark.parametrize(
    "fault",
    [
        "channel-open",
        *(
            pytest.param(f, marks=pytest.mark.long)
            for f in ("channel-stuck", "channel-short", "board-brown-out")
        ),
    ],
)
def test_the_faults_of_an_emulated_board_take_power_and_give_it_back(robot: DrilledRobot, fault: str) -> None:
    component = None if fault == "board-brown-out" else "lidar"
    robot.configure(policy="approve")  # it is planted until it was seen
    try:
        drill = robot.start_drill(fault, component, bound_s=300.0, detect_s=200.0)
        robot.in_state(drill["id"], "planted")
        assert [one["fault"] for one in robot.board_faults()] == [fault.partition("-")[2]]
        relay = fault in {"channel-stuck", "channel-short"}
        until(lambda: any(robot.blamed()) and (not relay or "not on(lidar)" in robot.held()), "it is seen")
        assert ("not on(lidar)" in robot.held()) is relay
        ended = robot.cancelled(drill["id"])
        assert (ended["undone"], robot.board_faults()) == (True, []), ended
    finally:
        robot.configure(policy="auto")
    robot.until_healthy()


@pytest.mark.parametrize("fault", ["board-mute", pytest.param("board-refuse", marks=pytest.mark.long)])
def test_a_board_that_cannot_be_heard_blames_nobody(robot: DrilledRobot, fault: str) -> None:
    drill = robot.start_drill(fault, bound_s=300.0, detect_s=200.0)
    until(lambda: robot.state().get("state") == "partly-unknown", "what the board says is not known")
    assert not any(robot.blamed())
    ended = robot.cancelled(drill["id"])
    assert (ended["component"], ended["undone"], ended["seen"]) == (None, True, None), ended


def test_a_fault_of_the_emulated_board_is_cleared_after_a_kill_of_the_service(robot: DrilledRobot) -> None:
    robot.configure(policy="approve")  # it is planted until the service is killed
    try:
        drill = robot.start_drill("channel-short", "base", bound_s=300.0, detect_s=200.0)
        robot.in_state(drill["id"], "planted")
        # Its driver holds a dead connection from then on: who looks for health later must know that.
        until(lambda: "not ok(odom)" in robot.held(), "its odometry is silent")
        robot.kill("service")
        assert robot.board_faults()
        robot.start_service()
        ended = robot.ended(drill["id"])
        assert (ended["undone"], robot.board_faults()) == (True, [])
        assert "restarted" in ended["cut_short"]
    finally:
        robot.configure(policy="auto")
    robot.until_healthy()


def test_while_a_fault_is_planted_the_robot_says_so_and_takes_no_other(robot: DrilledRobot) -> None:
    robot.configure(policy="approve")  # so that nobody repairs it at once
    try:
        with robot.client as client:
            drill = robot.start_drill("node-frozen", "mapping")
            robot.in_state(drill["id"], "planted")
            until(lambda: robot.halted() == ["mapping"], "it has come to the signal")
            named = robot.state()["drill"]
            assert (named["id"], named["undo"]) == (drill["id"], "let it go on")
            assert refused(robot, "node-killed", "lidar_node")[0] == 409
            found = client.robot("r1")
            with pytest.raises(ApiError, match="open; cancel it first"):
                client.delete_robot("r1", found.version)
            client.decide_drill(drill["id"], "cancel", "enough")
            ended = robot.ended(drill["id"])
            assert (ended["state"], ended["undone"]) == ("cancelled", True)
            assert "enough" in ended["cut_short"]
            assert robot.state()["drill"] is None
            assert robot.halted() == []
            with pytest.raises(ApiError, match="nothing to cancel"):
                client.decide_drill(drill["id"], "cancel")
    finally:
        robot.configure(policy="auto")


def test_a_repair_that_is_in_the_middle_of_its_plan_then_leaves_nothing_stopped(
    robot: DrilledRobot,
) -> None:
    """A halted process takes a second to be stopped, before it is started: the time is over in between."""
    with robot.client as client:
        for bound_s in (1.0, 1.5):
            drill = robot.start_drill("node-frozen", "mapping", bound_s=bound_s)
            ended = robot.ended(drill["id"])
            assert (ended["state"], ended["undone"]) == ("done", True), ended
            latest = client.repairs("r1", limit=1)["items"]
            assert not latest or latest[0]["drill"] is not None  # none of a real fault


def test_the_stop_forbids_the_undo_too_which_is_done_as_soon_as_it_is_lifted(robot: DrilledRobot) -> None:
    robot.configure(policy="approve")
    try:
        with robot.client as client:
            drill = robot.start_drill("node-frozen", "mapping", bound_s=4.0)
            robot.in_state(drill["id"], "planted")
            client.stop("somebody is at the robot")
            stopped = robot.in_state(drill["id"], "stopped")
            assert "somebody is at the robot" in stopped["reason"]
            assert "let it go on" in stopped["reason"]
            time.sleep(4.5)  # longer than its bound: time itself is what is tested
            assert robot.halted() == ["mapping"]
            assert robot.state()["drill"]["state"] == "stopped"
            assert refused(robot, "node-killed", "lidar_node")[0] == 409
            client.resume()
            ended = robot.ended(drill["id"])
            assert (ended["state"], ended["undone"]) == ("cancelled", True)
            assert robot.halted() == []
    finally:
        robot.configure(policy="auto")


def test_an_agent_that_goes_away_ends_the_drill_which_is_undone_when_it_is_back(robot: DrilledRobot) -> None:
    robot.configure(policy="approve")
    try:
        drill = robot.start_drill("node-frozen", "mapping", bound_s=300.0, detect_s=200.0)
        robot.in_state(drill["id"], "planted")
        robot.kill("agent")
        gone = robot.in_state(drill["id"], "undoing")
        assert "nobody reports" in gone["cut_short"]
        assert robot.state()["drill"]["undo"] == "let it go on"
        robot.start_agent()
        ended = robot.ended(drill["id"])
        assert ended["undone"], ended
        assert ended["state"] in {"cancelled", "failed"}  # its kill left more to be mended than the fault
    finally:
        robot.configure(policy="auto")


def test_an_undo_that_will_never_work_is_left_to_a_person_who_says_so(robot: DrilledRobot) -> None:
    robot.configure(policy="approve")
    try:
        drill = robot.start_drill("node-frozen", "mapping", bound_s=300.0, detect_s=200.0)
        robot.in_state(drill["id"], "planted")
        robot.kill("agent")  # before the bound is over: else it undoes the fault itself
        robot.in_state(drill["id"], "undoing")
        with robot.client as client:
            client.decide_drill(drill["id"], "abandon", "its computer burnt")
        ended = robot.ended(drill["id"])
        assert (ended["state"], ended["undone"]) == ("failed", False)
        assert "its computer burnt" in ended["reason"]
        assert "let it go on" in ended["reason"]
        robot.start_agent()
    finally:
        robot.configure(policy="auto")


def test_a_person_plants_and_undoes_with_their_hands_and_says_done(robot: DrilledRobot) -> None:
    with robot.client as client:
        drill = robot.start_drill("device-unplugged", "lidar", detect_s=1.0)
        asked = robot.drill(drill["id"], lambda one: one["waiting_for"] is not None)
        assert asked["waiting_for"] == "pull the data cable of lidar"
        client.decide_drill(drill["id"], "done")
        # The simulated cable is where it was: nothing is seen, and then it is to be plugged in.
        asked = robot.drill(drill["id"], lambda one: one["state"] == "undoing" and one["waiting_for"])
        assert asked["waiting_for"] == "plug it in"
        client.decide_drill(drill["id"], "done")
        ended = robot.ended(drill["id"])
        assert (ended["state"], ended["seen"]["detected_s"]) == ("done", None)
        with pytest.raises(ApiError, match="nothing to done"):
            client.decide_drill(drill["id"], "done")


def test_what_is_never_planted_is_refused_with_the_reason(robot: DrilledRobot) -> None:
    assert refused(robot, "node-killed", "logger") == (
        403,
        "node-killed:logger is never planted: logger is protected",
    )
    assert refused(robot, "node-killed", "lidar")[0] == 404
    assert refused(robot, "node-bored", "lidar_node")[0] == 422
    for changes, words in (
        ({"policy": "observe"}, "'observe'"),
        ({"allow": ["stop_node"]}, "no undo: start_node"),
        ({"actions": {"start_node": {"policy": "observe"}}}, "no undo: start_node"),
    ):
        robot.configure(**changes)
        try:
            status, why = refused(robot, "node-killed", "mapping")
        finally:
            robot.configure(policy="auto", allow=None, actions={})
        assert (status, words in why) == (403, True), why


def test_on_a_robot_in_use_or_not_well_nothing_is_planted(robot: DrilledRobot) -> None:
    never = [{"weekdays": [(time.gmtime().tm_wday + 3) % 7], "start": "00:00", "end": "00:01"}]
    robot.configure(windows=never)
    try:
        assert refused(robot, "node-killed", "mapping") == (409, "no maintenance window is open")
    finally:
        robot.configure(windows=[], believe=["a person"])  # who insists, against the agent
    with robot.client as client:
        client.stop("lunch")
        assert "lunch" in refused(robot, "node-killed", "mapping")[1]

        def unwell() -> bool:  # until the agent says otherwise, at its next heartbeat
            client.observe("r1", ["not ok(odom)"], source="a person", lifetime_s=30.0)
            client.diagnosis("r1")
            return "unhealthy" in refused(robot, "node-killed", "mapping")[1]

        until(unwell, "a refusal that says so")
        client.observe("r1", ["ok(odom)"], source="a person", lifetime_s=0.5)
        client.resume()
