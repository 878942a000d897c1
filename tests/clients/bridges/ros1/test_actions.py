"""Actions both ways, against the distribution's actionlib: its clients ask us, and we its servers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.clients.running_agent import SLEEPER, agent, config
from tests.clients.service_double import ServiceDouble, eventually
from tests.ros1 import Robot

RULE = "=" * 80
HEADER = f"\n{RULE}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
GOAL_ID = f"\n{RULE}\nMSG: actionlib_msgs/GoalID\ntime stamp\nstring id\n"
STATUS = f"\n{RULE}\nMSG: actionlib_msgs/GoalStatus\nGoalID goal_id\nuint8 status\nstring text\n" + "".join(
    f"uint8 {name}={number}\n"
    for number, name in enumerate(
        "PENDING ACTIVE PREEMPTED SUCCEEDED ABORTED REJECTED PREEMPTING RECALLING RECALLED LOST".split()  # noqa: SIM905  # as the message lists them
    )
)
P = "tug_ist_diagnosis_msgs/DiagnosisRepair"


def part(name: str, fields: str) -> str:
    return f"\n{RULE}\nMSG: {P}{name}\n{fields}"


REPAIR: dict[str, Any] = {
    "type": f"{P}Action",
    "definition": "DiagnosisRepairActionGoal action_goal\nDiagnosisRepairActionResult action_result\n"
    "DiagnosisRepairActionFeedback action_feedback\n"
    + part("ActionGoal", "Header header\nactionlib_msgs/GoalID goal_id\nDiagnosisRepairGoal goal\n")
    + part("ActionResult", "Header header\nactionlib_msgs/GoalStatus status\nDiagnosisRepairResult result\n")
    + part(
        "ActionFeedback",
        "Header header\nactionlib_msgs/GoalStatus status\nDiagnosisRepairFeedback feedback\n",
    )
    + part("Goal", "string[] parameter\n")
    + part("Result", "int32 result\n")
    + part("Feedback", "int32 feedback\n")
    + HEADER
    + GOAL_ID
    + STATUS,
}
SUCCEEDED, REJECTED = 3, 5


def test_actions_go_both_ways_between_the_agent_and_the_robots_own_nodes(
    ros1: Robot, service: ServiceDouble, tmp_path: Path
) -> None:
    client, server = ros1.node("client"), ros1.node("arm")
    server.do("serve", name="/arm/calibrate", **REPAIR)
    server.do("serve", name="/arm/refuse", aborts=True, result=7, **REPAIR)
    server.do("serve", name="/arm/slow", takes_s=60, **REPAIR)
    either = {"kind": "ros_action", "parameters": {"arm": ["left", "right"]}}
    actions = {
        "calibrate": {**either, "server": "/arm/calibrate"},
        "recalibrate": {**either, "server": "/arm/calibrate"},
        "refuse": {**either, "server": "/arm/refuse"},
        "slow": {**either, "server": "/arm/slow", "gives_up": True},
        "absent": {**either, "server": "/arm/absent"},
    }
    bridge = {"master": ros1.master.uri, "serve": ["start_node", "stop_node", "dance"]}
    processes = {"laser": {"command": SLEEPER}}
    with agent(config(tmp_path, service.url, processes, actions=actions, ros1=bridge)):
        # Its feedback has a connection of its own, on which the result does not wait for it.
        for name, runs in (("start_node", True), ("stop_node", False)):
            found = client.do("act", name=name, parameter=["laser"], **REPAIR)
            assert (found["state"], found["result"]) == (SUCCEEDED, 0)
            eventually(lambda runs=runs: service.holds().get("running(laser)") is runs, f"{runs}", 60)  # type: ignore[misc]  # bound for this round
        found = client.do("act", name="start_node", parameter=["laser; reboot"], **REPAIR)
        assert (found["state"], found["result"]) == (REJECTED, 2)
        assert "start_node(laser; reboot) is not allowed" in found["text"]

        done = service.do("r:1", "calibrate", "left", timeout_s=60)
        assert done["code"] == 0, done
        assert [line["value"] for line in server.heard] == [["left"]]
        assert service.do("r:7", "recalibrate", "right", timeout_s=60)["code"] == 0  # of the same server
        assert service.do("r:2", "refuse", "left", timeout_s=60)["code"] == 7
        assert service.do("r:3", "calibrate", "up", timeout_s=60)["code"] == 2  # no parameter of the list
        absent = service.do("r:4", "absent", "left", timeout_s=60)
        assert (absent["code"], "there is no action server /arm/absent" in absent["message"]) == (4, True)
        service.ask("r:5", "slow", "left", timeout_s=90)
        eventually(lambda: "/arm/slow: 50" in service.feedback("r:5"), "that it is under way", 60)
        service.withdrawn.add("r:5")
        eventually(lambda: service.result("r:5"), "that it was given up", 60)
        eventually(lambda: server.heard[-1]["value"] == "preempted", "that the server was told", 60)
        service.ask("r:6", "slow", "right", timeout_s=90)
        eventually(lambda: "/arm/slow: 50" in service.feedback("r:6"), "that it is under way", 60)
        server.kill()
        eventually(lambda: service.result("r:6"), "a result", 60)
        result = service.result("r:6") or {}
        assert (result["code"], "whether it acted is unknown" in result["message"]) == (3, True)
    log = (tmp_path / "agent.log").read_text()
    assert log.count("dance: cannot be served: this agent can do start_node, stop_node") == 1
