"""An rclpy node that does what lines of JSON on its standard input say; it runs in an environment of its own.

    {"do": "publish", "topic": "/scan", "type": "std_msgs/String", "value": {"data": "x"}, "rate": 10}
    {"do": "subscribe", "topic": "/diagnosis", "type": …}    what comes is printed: {"heard": topic, …}

`raw` instead of `value`: bytes in hexadecimal, whatever the type. `stamped`: a header has the robot's time,
less `behind_s`. `moves`: the number that counts up, as `data` or `acceleration.z`.
`of`: another node of the process, by its name.
"""

from __future__ import annotations

import importlib
import json
import sys
import threading
import time
from collections.abc import Callable
from functools import reduce
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import MultiThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time


def say(**value: Any) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


def load(name: str) -> Any:
    package, _, short = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), short)


def quality(line: dict[str, Any]) -> QoSProfile:
    reliable, latched = line.get("reliable", True), line.get("latched", False)
    return QoSProfile(
        depth=10,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def fill(message: Any, value: dict[str, Any]) -> Any:
    kinds = message.get_fields_and_field_types()
    for name, part in value.items():
        kind = kinds[name]
        if isinstance(part, dict):
            fill(getattr(message, name), part)
        elif isinstance(part, list) and part and isinstance(part[0], dict):
            inside = load(kind.removeprefix("sequence<").removesuffix(">"))
            setattr(message, name, [fill(inside(), item) for item in part])
        elif kind == "builtin_interfaces/Time":
            setattr(message, name, Time(nanoseconds=int(part * 1e9)).to_msg())
        else:
            setattr(message, name, bytes([part]) if kind in ("octet", "byte") else part)
    return message


def plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value if isinstance(value, int | float | str | bool) else str(value)


class Commands:
    def __init__(self, name: str, executor: Any) -> None:
        self.executor = executor
        self.node = rclpy.create_node(name)
        executor.add_node(self.node)
        self.others: dict[str, Any] = {}
        self.publishers: dict[str, Any] = {}
        self.timers: dict[str, Any] = {}
        self.goals = 0

    def nothing(self, line: dict[str, Any]) -> None:
        pass

    def simulated(self, line: dict[str, Any]) -> None:
        """Live by /clock."""
        self.node.set_parameters([Parameter("use_sim_time", value=True)])

    def asked(self, line: dict[str, Any]) -> int:
        """Return how many goals its action servers have got."""
        return self.goals

    def also(self, line: dict[str, Any]) -> None:
        """Be another node, too."""
        other = rclpy.create_node(line["name"], namespace=line.get("namespace", "/"))
        self.others[line["name"]] = other
        self.executor.add_node(other)

    def no_longer(self, line: dict[str, Any]) -> None:
        other = self.others.pop(line["name"])
        self.executor.remove_node(other)
        other.destroy_node()

    def publish(self, line: dict[str, Any]) -> None:
        topic, kind = line["topic"], load(line["type"])
        node: Any = self.others.get(line.get("of", ""), self.node)
        publisher = self.publishers[topic] = node.create_publisher(kind, topic, quality(line))
        raw = bytes.fromhex(line["raw"]) if "raw" in line else None
        message: Any = raw if raw is not None else fill(kind(), line.get("value", {}))

        def once() -> None:
            if line.get("stamped"):
                behind = Duration(seconds=line.get("behind_s", 0))
                header = getattr(message, "header", message)
                header.stamp = (self.node.get_clock().now() - behind).to_msg()
            if moves := line.get("moves"):
                *path, last = moves.split(".")
                part = reduce(getattr, path, message)
                setattr(part, last, getattr(part, last) + 1)
            publisher.publish(message)

        if "rate" in line:
            real = Clock(clock_type=ClockType.STEADY_TIME)
            self.timers[topic] = self.node.create_timer(1 / line["rate"], once, clock=real)
        else:
            publisher.publish(message)

    def relay(self, line: dict[str, Any]) -> None:
        """Publish on one topic, as soon as something comes on another."""
        topic, kind = line["to"], load(line["type"])
        node: Any = self.others.get(line.get("of", ""), self.node)
        publisher = self.publishers[topic] = node.create_publisher(kind, topic, 10)
        node.create_subscription(kind, line["topic"], publisher.publish, quality(line))

    def hush(self, line: dict[str, Any]) -> None:
        self.node.destroy_timer(self.timers.pop(line["topic"]))

    def unpublish(self, line: dict[str, Any]) -> None:
        if line["topic"] in self.timers:
            self.hush(line)
        self.node.destroy_publisher(self.publishers.pop(line["topic"]))

    def lifecycle(self, line: dict[str, Any]) -> None:
        """Be a node with a lifecycle, too; active, it does `then`."""
        commands = self
        from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

        class Managed(LifecycleNode):  # type: ignore[misc]  # rclpy is not where types are checked
            def on_configure(self, state: Any) -> Any:
                refused = line.get("refuses", False)
                return TransitionCallbackReturn.FAILURE if refused else TransitionCallbackReturn.SUCCESS

            def on_activate(self, state: Any) -> Any:
                say(heard=line["name"], value="active")
                commands.also_do(line)
                return super().on_activate(state)

        self.others[line["name"]] = Managed(line["name"])
        self.executor.add_node(self.others[line["name"]])

    def move(self, line: dict[str, Any]) -> None:
        """Make a transition of a node with a lifecycle."""
        getattr(self.others[line["name"]], f"trigger_{line['transition']}")()

    def manage(self, line: dict[str, Any]) -> None:
        """Manage the lifecycles of `nodes` as nav2 does: bring all up, and take all down when one is gone."""
        from lifecycle_msgs.srv import ChangeState

        made = {name: self.node.create_client(ChangeState, f"{name}/change_state") for name in line["nodes"]}

        def change(wait_s: float, *transitions: int) -> None:
            for transition in transitions:
                for client in made.values():
                    if client.wait_for_service(wait_s):
                        request = ChangeState.Request()
                        request.transition.id = transition
                        client.call_async(request)
                time.sleep(0.5)  # as long as a transition may take

        def watch() -> None:
            change(60.0, 1, 3)  # configure, activate
            while all(client.service_is_ready() for client in made.values()):
                time.sleep(0.2)  # as its bond does
            change(1.0, 4)  # deactivate

        threading.Thread(target=watch, daemon=True).start()

    def log(self, line: dict[str, Any]) -> None:
        """Write a line of a level."""
        logger, text = self.node.get_logger(), line["text"]
        {
            "info": lambda: logger.info(text),  # of one place rclpy takes one level only
            "warning": lambda: logger.warning(text),
            "error": lambda: logger.error(text),
            "fatal": lambda: logger.fatal(text),
        }[line["level"]]()

    def act(self, line: dict[str, Any]) -> int:
        """Send a goal, and cancel it if that is asked for; return what became of it."""
        import time

        from rclpy.action import ActionClient
        from test_msgs.action import Fibonacci

        def done(ask: Callable[[], Any]) -> Any:
            """Return the answer; it is asked for again, as rclpy drops one that comes before it noted that it
            asked, from another thread than its executor's.
            """
            for _ in range(4):
                future, deadline = ask(), time.monotonic() + 10
                while not future.done() and time.monotonic() < deadline:
                    time.sleep(0.01)
                if future.done():
                    return future.result()
            raise RuntimeError(f"no answer of {line['name']}")

        client = self.others.setdefault(
            "to " + line["name"], ActionClient(self.node, Fibonacci, line["name"])
        )
        if not client.wait_for_server(30):
            raise RuntimeError(f"no server {line['name']}")
        goal = done(lambda: client.send_goal_async(Fibonacci.Goal(order=line.get("order", 1))))
        if line.get("cancel"):
            done(goal.cancel_goal_async)
        return int(done(goal.get_result_async).status)

    def offer(self, line: dict[str, Any]) -> None:
        """Offer a service; what it is asked is printed. Answers with `answer` and does `then`; or never."""
        import time

        package, _, short = line["type"].split("/")
        kind = getattr(importlib.import_module(f"{package}.srv"), short)

        def asked(request: Any, response: Any) -> Any:
            say(heard=line["name"], value=plain(request))
            self.also_do(line)
            while line.get("never"):
                time.sleep(0.1)
            for name, value in line.get("answer", {}).items():
                setattr(response, name, value)
            return response

        self.others[line["name"]] = self.node.create_service(kind, line["name"], asked)

    def also_do(self, line: dict[str, Any]) -> None:
        """Do what a line says under `then`, once, and not in the middle of something."""
        then = line.pop("then", None)
        if then is not None:
            threading.Timer(0.1, getattr(self, then["do"]), (then,)).start()

    def declare(self, line: dict[str, Any]) -> None:
        """Have a parameter; what it is set to is printed and followed by `then`; above `most` is refused."""
        from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult

        described = ParameterDescriptor(read_only=line.get("read_only", False))
        self.node.declare_parameter(line["name"], line["value"], described)

        def checked(parameters: list[Any]) -> Any:
            for one in parameters:
                if one.name == line["name"]:
                    say(heard=one.name, value=one.value)
                    if "most" in line and one.value > line["most"]:
                        return SetParametersResult(successful=False, reason="the lens does not do that")
                    self.also_do(line)
            return SetParametersResult(successful=True)

        self.node.add_on_set_parameters_callback(checked)

    def serve(self, line: dict[str, Any]) -> None:
        """An action server that counts as far as it is asked to, or waits until it is cancelled; a goal of
        13 is aborted.
        """
        from rclpy.action import ActionServer, CancelResponse
        from rclpy.callback_groups import ReentrantCallbackGroup
        from test_msgs.action import Fibonacci

        def execute(goal: Any) -> Any:
            self.goals += 1
            while line.get("waits") and not goal.is_cancel_requested:
                time.sleep(0.01)
            if goal.is_cancel_requested:
                say(heard=line["name"], value="cancelled")
                goal.canceled()
                return Fibonacci.Result()
            if goal.request.order == 13:
                goal.abort()
                return Fibonacci.Result()
            goal.succeed()
            return Fibonacci.Result(sequence=list(range(goal.request.order)))

        self.others[line["name"]] = ActionServer(
            self.node,
            Fibonacci,
            line["name"],
            execute,
            callback_group=ReentrantCallbackGroup(),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def subscribe(self, line: dict[str, Any]) -> None:
        def heard(message: Any) -> None:
            say(heard=line["topic"], value=plain(message))

        self.node.create_subscription(load(line["type"]), line["topic"], heard, quality(line))


def main() -> None:
    rclpy.init()
    executor = MultiThreadedExecutor(2)
    commands = Commands(sys.argv[1], executor)
    threading.Thread(target=executor.spin, daemon=True).start()
    for text in sys.stdin:
        line = json.loads(text)
        try:
            say(answer=getattr(commands, line["do"])(line))
        except Exception as error:  # noqa: BLE001  # told to the test
            say(error=f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
