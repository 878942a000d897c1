"""A rospy node that does what lines of JSON on its standard input say; it runs on the distribution's Python.

    {"do": "publish", "topic": "/scan", "type": "std_msgs/String", "value": {"data": "x"}, "rate": 10}
    {"do": "subscribe", "topic": "/observations", "type": …}    what comes is printed: {"heard": topic, …}

A type may come with its text (`definition`): no package needs to be built. `stamped`: a header has the
robot's time, less `behind_s`. `moves`: a number counts up.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import actionlib
import genpy.dynamic
import roslib.message
import rospy
import yaml

OUT, sys.stdout = sys.stdout, sys.stderr  # rospy prints what is logged


def say(**value: Any) -> None:
    OUT.write(json.dumps(value) + "\n")
    OUT.flush()


def load(line: dict[str, Any]) -> Any:
    if "definition" in line:
        KINDS.update(genpy.dynamic.generate_dynamic(line["type"], line["definition"]))
        return KINDS[line["type"]]
    return roslib.message.get_message_class(line["type"])


KINDS: dict[str, Any] = {}


def fill(message: Any, value: dict[str, Any]) -> Any:
    for name, part in value.items():
        kind = message._slot_types[message.__slots__.index(name)].partition("[")[0]
        if kind == "time":
            setattr(message, name, genpy.Time.from_sec(part))
        elif isinstance(part, dict):
            fill(getattr(message, name), part)
        elif isinstance(part, list) and part and isinstance(part[0], dict):
            make = KINDS.get(kind) or roslib.message.get_message_class(kind)
            setattr(message, name, [fill(make(), item) for item in part])
        else:
            setattr(message, name, part)
    return message


class Talker:
    def __init__(self, line: dict[str, Any]) -> None:
        self.kind = load(line)
        self.publisher = rospy.Publisher(
            line["topic"], self.kind, queue_size=10, latch=line.get("latch", False)
        )
        self.value = line.get("value", {})
        self.rate = line.get("rate", 0)
        self.stamped = line.get("stamped", False)
        self.behind_s = line.get("behind_s", 0)
        self.moves, self.count = line.get("moves", False), 0
        self.end = threading.Event()
        if self.rate:
            threading.Thread(target=self.run, daemon=True).start()

    def once(self) -> None:
        message = fill(self.kind(), self.value)
        if self.stamped:
            header = getattr(message, "header", message)
            header.stamp = rospy.get_rostime() - rospy.Duration(self.behind_s)
        if self.moves:
            self.count += 1
            message.data = self.count
        self.publisher.publish(message)

    def run(self) -> None:
        while not self.end.wait(1 / self.rate):
            self.once()


class Node:
    def __init__(self) -> None:
        self.talkers: dict[str, Talker] = {}
        self.servers: list[Any] = []

    def nothing(self, line: dict[str, Any]) -> None:
        pass

    def simulated(self, line: dict[str, Any]) -> None:
        """Let nodes that begin from now on live by /clock."""
        rospy.set_param("/use_sim_time", True)

    def log(self, line: dict[str, Any]) -> None:
        """Write a line of a level."""
        level = {"info": "info", "warning": "warn", "error": "err", "fatal": "fatal"}[line["level"]]
        getattr(rospy, f"log{level}")(line["text"])

    def publish(self, line: dict[str, Any]) -> None:
        talker = self.talkers[line["topic"]] = Talker(line)
        if not talker.rate and "value" in line:
            deadline = time.monotonic() + 30
            while not talker.publisher.get_num_connections() and time.monotonic() < deadline:
                time.sleep(0.01)
            talker.once()

    def again(self, line: dict[str, Any]) -> None:
        talker = self.talkers[line["topic"]]
        talker.value = line.get("value", talker.value)
        talker.once()

    def hush(self, line: dict[str, Any]) -> None:
        self.talkers[line["topic"]].end.set()

    def unpublish(self, line: dict[str, Any]) -> None:
        talker = self.talkers.pop(line["topic"])
        talker.end.set()
        talker.publisher.unregister()

    def subscribe(self, line: dict[str, Any]) -> None:
        kind = load(line)

        def heard(message: Any) -> None:
            value = yaml.safe_load(str(message))
            say(heard=line["topic"], value=value, by=message._connection_header["callerid"])

        rospy.Subscriber(line["topic"], kind, heard)

    def leave(self, line: dict[str, Any]) -> None:
        rospy.signal_shutdown("asked to")

    def offer(self, line: dict[str, Any]) -> None:
        """Offer a service of a type whose parts are given as texts; what it is asked is printed."""

        class Kind:
            _type, _md5sum = line["type"], line["md5"]

        for part in ("request", "response"):
            name = f"{line['type']}{part.title()}"
            KINDS.update(genpy.dynamic.generate_dynamic(name, line[part]))
            setattr(Kind, f"_{part}_class", KINDS[name])

        def asked(request: Any) -> Any:
            say(heard=line["name"], value=yaml.safe_load(str(request)), by="")
            if line.get("never"):
                time.sleep(1000)  # it hangs
            if line.get("fails"):
                raise rospy.ServiceException(line["fails"])
            if "then" in line:
                then = line.pop("then")
                getattr(self, then["do"])(then)
            if line.get("echo"):
                return KINDS[f"{line['type']}Response"](*(getattr(request, s) for s in request.__slots__))
            return fill(KINDS[f"{line['type']}Response"](), line.get("answer", {}))

        rospy.Service(line["name"], Kind, asked)

    def parameter(self, line: dict[str, Any]) -> Any:
        """Return a parameter of the parameter server, set first where there is a value."""
        if "value" in line:
            rospy.set_param(line["name"], line["value"])
        return rospy.get_param(line["name"])

    def serve(self, line: dict[str, Any]) -> None:
        """An action server of strings and an integer."""
        kinds = genpy.dynamic.generate_dynamic(line["type"], line["definition"])
        action = kinds[line["type"]]
        result, feedback = type(action().action_result.result), type(action().action_feedback.feedback)

        def execute(goal: Any) -> None:
            server.publish_feedback(feedback(feedback=50))
            deadline = time.monotonic() + line.get("takes_s", 0)
            while time.monotonic() < deadline:
                if server.is_preempt_requested():
                    say(heard=line["name"], value="preempted", by="")
                    server.set_preempted()
                    return
                time.sleep(0.01)
            say(heard=line["name"], value=list(goal.parameter), by="")
            if line.get("aborts") or "13" in goal.parameter:
                server.set_aborted(result(result=line.get("result", 1)), "it does not want to")
            else:
                server.set_succeeded(result(result=line.get("result", 0)))

        server = actionlib.SimpleActionServer(line["name"], action, execute, auto_start=False)
        server.start()
        self.servers.append(server)

    def act(self, line: dict[str, Any]) -> Any:
        """Be a client: send a goal, return state, result and feedback."""
        action = genpy.dynamic.generate_dynamic(line["type"], line["definition"])[line["type"]]
        client = actionlib.SimpleActionClient(line["name"], action)
        if not client.wait_for_server(rospy.Duration(30)):
            raise RuntimeError(f"no server {line['name']}")
        goal = fill(type(action().action_goal.goal)(), line.get("goal") or {"parameter": line["parameter"]})
        told: list[int] = []
        client.send_goal(goal, feedback_cb=lambda message: told.append(message.feedback))
        if "cancel" in line:
            deadline = time.monotonic() + 2  # a feedback may be lost: nobody had subscribed yet
            while not told and time.monotonic() < deadline:
                time.sleep(0.01)
            client.cancel_goal()
        client.wait_for_result(rospy.Duration(30))
        answer = client.get_result()
        return {
            "state": client.get_state(),
            "text": client.get_goal_status_text(),
            "result": getattr(answer, "result", None),
            "answer": yaml.safe_load(str(answer)),
            "feedback": told,
        }


def main() -> None:
    rospy.init_node(sys.argv[1], disable_signals=True)
    node = Node()
    for text in sys.stdin:
        line = json.loads(text)
        try:
            say(answer=getattr(node, line["do"])(line))
        except Exception as error:  # noqa: BLE001  # told to the test
            say(error=f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
