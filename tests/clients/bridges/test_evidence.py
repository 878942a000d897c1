"""What a real robot says of itself reaches the service with its words, and usual traffic raises no alarm.

Each kind of evidence is planted on real nodes (rclpy, rospy, a peer of zenoh), under a whole agent.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.clients.bridges.any_robot import AnyRobot, any_robot
from tests.clients.bridges.ros1.test_actions import REPAIR
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually, service_double

WAIT_S = 60

STAMPED = {"ros1": "actionlib_msgs/GoalStatusArray", "ros2": "sensor_msgs/Range"}
"""Types with a header that each robot has."""


class Watched:
    """A robot under an agent with these observers."""

    def __init__(self, service: ServiceDouble) -> None:
        self.service = service

    def is_said(self, atom: str, sign: bool | None, *parts: str) -> None:
        """Wait until an atom has this sign, and its reading these parts."""

        def said() -> bool:
            told = self.reading(atom)
            return self.service.signs().get(atom) is sign and all(part in told for part in parts)

        wanted = f"{sign} of {atom} with {parts}"
        try:
            eventually(said, wanted, WAIT_S)
        except AssertionError as error:
            raise AssertionError(f"{error}: {self.service.signs()}, {self.reading(atom)!r}") from None

    def reading(self, atom: str) -> str:
        """Return the newest reading of an atom, as JSON: value, limit, symptom."""
        for batch in reversed(self.service.batches()):
            for sentence, reading in zip(batch["observations"], batch.get("readings") or [], strict=False):
                if sentence.removeprefix("not ") == atom:
                    return str(reading)
        return ""

    @property
    def ever_bad(self) -> set[str]:
        return {
            sentence
            for batch in self.service.batches()
            for sentence in batch["observations"]
            if sentence.startswith("not ")
        }


@contextmanager
def watched(
    robot: AnyRobot, folder: Path, observers: Mapping[str, Mapping[str, Any]], **more: Any
) -> Iterator[Watched]:
    origin = {"from": robot.origin}
    sections: dict[str, Any] = {
        robot.origin: robot.section,
        "observers": {name: {**origin, **keys} for name, keys in observers.items()},
        **more,
    }
    with service_double() as service, agent(config(folder, service.url, {}, **sections)):
        yield Watched(service)


def goals(robot: AnyRobot, action: str = "dock") -> dict[str, Any]:
    preset = {"preset": "ros1"} if robot.origin == "ros1" else {}
    return {"kind": "goals", "action": action, "hold_s": 3600, **preset}


def act(robot: AnyRobot, *, aborts: bool = False, cancel: bool = False) -> None:
    """Have a node send a goal, and wait for its end."""
    node, name = robot.nodes["mission"], "slow" if cancel else "dock"
    if robot.origin == "ros1":
        cancelling = {"cancel": True} if cancel else {}
        node.do("act", name=name, parameter=["13" if aborts else "1"], **REPAIR, **cancelling)
    else:
        node.do("act", name=name, order=13 if aborts else 1, cancel=cancel)


@pytest.mark.parametrize("robot", ["ros1", "ros2"], indirect=True)
def test_usual_traffic_raises_no_alarm_and_each_kind_of_evidence_is_reported_with_its_words(
    robot: AnyRobot, tmp_path: Path
) -> None:
    navigator, camera, _ = (robot.node(name) for name in ("navigator", "camera", "mission"))
    old = robot.origin == "ros1"
    navigator.do("serve", name="dock", **(REPAIR if old else {}))
    navigator.do("serve", name="slow", **({"takes_s": 60, **REPAIR} if old else {"waits": True}))
    number = {"type": "std_msgs/Float64", "rate": 10}
    stamped = {"topic": "/scan", "type": STAMPED[robot.origin], "rate": 10, "stamped": True}
    observers: dict[str, dict[str, Any]] = {
        "ok(goals,dock)": goals(robot),
        "ok(goals,slow)": goals(robot, "slow"),
        "ok(log,camera)": {"kind": "rosout", "hold_s": 3, "ignore": ["harmless"]},
        "ok(log,mission)": {"kind": "rosout"},  # actionlib logs an ERROR where a goal is cancelled
        "ok(log,navigator)": {"kind": "rosout", "hold_s": 3},
        "ok(moves,imu)": {"kind": "changing", "source": "imu:data", "still_s": 2},
        "ok(age,scan)": {"kind": "age"},
        "ok(publishers,odom)": {"kind": "publishers", "first_s": 600},
        "ok(restarts,navigator)": {"kind": "restarts", "table": "nodes", "hold_s": 2},
    }
    if not old:
        observers["ok(qos,scan)"] = {"kind": "qos"}
    with watched(robot, tmp_path, observers) as seen:
        eventually(lambda: seen.service.polls, "the agent", WAIT_S)
        camera.do("publish", topic="/imu", moves="data", **number)  # late
        camera.do("publish", **stamped)
        camera.do("publish", topic="/odom", **number)
        for n in range(3):
            for node in robot.nodes.values():
                node.do("log", level="info", text=f"line {n}")
                node.do("log", level="warning", text=f"warning {n}: an ERROR that is none")
            camera.do("log", level="error", text="this is harmless")
            act(robot)
            act(robot, cancel=True)
        for atom in observers.keys() - {
            "ok(goals,slow)",
            "ok(log,mission)",
        }:  # nothing is said of them
            seen.is_said(atom, True)
        seen.is_said("ok(publishers,odom)", True, "/camera")
        assert seen.ever_bad == set()

        act(robot, aborts=True)
        why = ": it does not want to" if old else ""
        seen.is_said("ok(goals,dock)", False, f"goal aborted{why}", "self-report")
        act(robot)
        seen.is_said("ok(goals,dock)", True, "goal succeeded")
        camera.do("log", level="error", text="cannot open <b>/dev/video0</b>\n\x1b[31m" + "x" * 200_000)
        seen.is_said("ok(log,camera)", False, "ERROR: cannot open <b>/dev/video0</b>", "self-report")
        camera.do("log", level="fatal", text="giving up")
        seen.is_said("ok(log,camera)", False, "last FATAL: giving up")
        seen.is_said("ok(log,camera)", True, "no ERROR for 3 s")
        assert seen.ever_bad == {"not ok(goals,dock)", "not ok(log,camera)"}

        camera.do("unpublish", topic="/imu")
        camera.do("publish", topic="/imu", value={"data": 0.5}, **number)
        seen.is_said("ok(moves,imu)", False, "data stands still at 0.5 since ", " UTC", "still")
        camera.do("unpublish", topic="/scan")
        camera.do("publish", behind_s=3 * 3600, **stamped)
        seen.is_said("ok(age,scan)", False, "stamp 3 h behind", "at most 2 s", "old")
        navigator.do("publish", topic="/odom", **number)
        both = "2 publishers: /camera, /navigator"
        seen.is_said("ok(publishers,odom)", False, both, "at most 1", "publishers")
        navigator.do("unpublish", topic="/odom")
        seen.is_said("ok(publishers,odom)", True, "/camera")
        camera.do("unpublish", topic="/odom")
        seen.is_said("ok(publishers,odom)", False, "nobody publishes it", "silent")


@pytest.mark.parametrize("robot", ["ros1", "ros2"], indirect=True)
def test_of_ten_thousand_goals_the_one_that_was_aborted_is_reported_and_nothing_else(
    robot: AnyRobot, tmp_path: Path
) -> None:
    node, old, now_s = robot.node("navigator"), robot.origin == "ros1", int(time.time())
    topic = "/dock/status" if old else "/dock/_action/status"
    kind = "actionlib_msgs/GoalStatusArray" if old else "action_msgs/GoalStatusArray"

    def goal(number: int, status: int) -> dict[str, Any]:
        if old:
            return {"goal_id": {"id": f"goal {number}", "stamp": now_s}, "status": status}
        uuid = list(number.to_bytes(16, "big"))
        return {"goal_info": {"goal_id": {"uuid": uuid}, "stamp": {"sec": now_s}}, "status": status}

    succeeded, aborted = (3, 4) if old else (4, 6)
    goals_of = [goal(number, succeeded) for number in range(10_000)]
    observers = {
        "ok(goals,dock)": goals(robot),
        "ok(publishers,odom)": {"kind": "publishers", "first_s": 600},
    }
    with watched(robot, tmp_path, observers) as seen:
        eventually(lambda: seen.service.polls, "the agent", WAIT_S)
        node.do("publish", topic="/odom", type="std_msgs/Float64", rate=10)
        node.do("publish", topic=topic, type=kind, rate=2, value={"status_list": goals_of})
        for atom in observers:
            seen.is_said(atom, True)
        node.do("unpublish", topic=topic)
        goals_of.append(goal(10_001, aborted))  # servers list them in the order in which they took them
        node.do("publish", topic=topic, type=kind, rate=2, value={"status_list": goals_of})
        seen.is_said("ok(goals,dock)", False, "goal aborted")
        assert seen.ever_bad == {"not ok(goals,dock)"}


def test_a_node_of_ros_2_that_leaves_its_state_and_qualities_that_do_not_fit_are_reported(
    tmp_path: Path,
) -> None:
    with any_robot("ros2", tmp_path) as robot:
        camera = robot.node("driver")
        camera.do("lifecycle", name="camera")
        laser, slam = robot.node("laser"), robot.node("slam")
        laser.do("publish", topic="/scan", type="std_msgs/String", rate=10, reliable=False)
        observers = {"ok(lifecycle,camera)": {"kind": "lifecycle"}, "ok(qos,scan)": {"kind": "qos"}}
        with watched(robot, tmp_path, observers) as seen:
            seen.is_said("ok(qos,scan)", True, "fits")
            for transition in ("configure", "activate"):
                camera.do("move", name="camera", transition=transition)
            seen.is_said("ok(lifecycle,camera)", True, "active")
            camera.do("move", name="camera", transition="deactivate")
            seen.is_said("ok(lifecycle,camera)", False, "inactive, not active", "self-report")
            camera.do("move", name="camera", transition="activate")
            seen.is_said("ok(lifecycle,camera)", True, "active")
            slam.do("subscribe", topic="/scan", type="std_msgs/String")
            both = "/laser publishes best effort, /slam asks for reliable: no message goes there"
            seen.is_said("ok(qos,scan)", False, both)
            slam.kill()


def test_zenoh_hands_on_goals_and_lines_as_dds_does(tmp_path: Path) -> None:
    with any_robot("zenoh", tmp_path) as robot:
        observers = {"ok(goals,dock)": goals(robot), "ok(log,camera)": {"kind": "rosout"}}
        node = robot.node("camera")
        with watched(robot, tmp_path, observers) as seen:
            log = {"topic": "/rosout", "type": "rcl_interfaces/Log", "rate": 5}
            status = {"topic": "/dock/_action/status", "type": "action_msgs/GoalStatusArray", "rate": 5}
            node.do("publish", **log, value={"level": 40, "name": "camera", "msg": "no frames"})
            seen.is_said("ok(log,camera)", False, "ERROR: no frames")
            for name, state, sign in ((1, 2, None), (1, 4, True), (2, 2, True), (2, 6, False)):
                stamp = {"sec": int(time.time())}
                goal = {"goal_info": {"goal_id": {"uuid": [name] * 16}, "stamp": stamp}, "status": state}
                node.do("publish", **status, value={"status_list": [goal]})
                if sign is not None:
                    seen.is_said("ok(goals,dock)", sign)
                node.do("unpublish", topic=status["topic"])


def test_a_process_that_crashes_again_and_again_is_reported_with_its_last_words(tmp_path: Path) -> None:
    crash = ["sh", "-c", "sleep 3; echo 'cannot open /dev/lidar' >&2; exit 3"]
    processes = {"lidar_drv": {"command": crash, "start": True}}
    observers = {"ok(restarts,lidar_drv)": {"kind": "restarts", "restarts": 3}}
    with service_double() as service, agent(config(tmp_path, service.url, processes, observers=observers)):
        seen = Watched(service)
        for n in range(3):
            seen.is_said("running(lidar_drv)", False, "exit code 3: cannot open /dev/lidar", "ended")
            service.ask(f"a{n}", "start_node", "lidar_drv")
            seen.is_said("running(lidar_drv)", True)
        words = ("3 restarts, each within 30 s", "exit code 3: cannot open /dev/lidar")
        seen.is_said("ok(restarts,lidar_drv)", False, *words)
