"""The package for robots that have ROS 2 themselves: its programs, run by a real rclpy."""

from __future__ import annotations

import ast
import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from tests.blocks import BLOCKS
from tests.network import own_port
from tests.packages import KILTED, ROSLAUNCH
from tests.ros2 import Ros2Robot, robot
from tests.waiting import eventually, until

from robomend_client.actions import FAILED, OK, Action
from robomend_client.agent.broker import Broker, TopicMessage
from robomend_client.agent.executors.program import Program

PACKAGE = Path(__file__).parents[3] / "clients" / "robomend_ros"
FIBONACCI = "test_msgs/action/Fibonacci"


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Ros2Robot]:
    with robot(tmp_path) as found:
        yield found


def environment(ros: Ros2Robot) -> dict[str, str]:
    return {**ros.environment, "PYTHONPATH": str(PACKAGE)}


def command(program: str, *arguments: str) -> list[str]:
    return [str(KILTED.python), "-m", f"robomend_ros.{program}", *arguments]


@contextmanager
def feeder(ros: Ros2Robot, bus: str, sources: str) -> Iterator[subprocess.Popen[bytes]]:
    given = ("--ros-args", "-p", f"bus:={bus}", "-p", f"sources:={sources}")
    with (ros.folder / "feeder.log").open("ab") as log:
        process = subprocess.Popen(command("feeder", *given), env=environment(ros), stderr=log)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(60)


def test_the_feeder_hands_ticks_fields_and_nodes_to_the_agents_bus(ros: Ros2Robot) -> None:
    node = ros.node("laser")
    node.do("publish", topic="/scan", type="std_msgs/String", value={"data": "x"}, rate=20, reliable=False)
    node.do("publish", topic="/odom", type="sensor_msgs/LaserScan", value={"ranges": [1.0, 2.5]}, rate=20)

    async def test() -> None:
        told: dict[str, TopicMessage] = {}

        def on_message(message: TopicMessage) -> None:
            told[message.topic] = message

        broker = Broker("tcp:127.0.0.1:0", on_message)
        await broker.open()
        try:
            with feeder(ros, broker.address, "scan,odom:ranges.1,odom:nothing"):
                await eventually(lambda: {"scan", "odom", "nodes"} <= told.keys(), "all three", 60)
                assert (told["scan"].data, told["scan"].fields) == (None, None)
                assert told["scan"].time_ns is not None
                assert told["odom"].fields == {"ranges.1": 2.5}
                await eventually(lambda: "laser" in nodes(told["nodes"]), "the node", 60)
                node.kill()
                log = ros.folder / "feeder.log"
                assert log.read_text().count("odom:nothing: there is no such field") == 1
        finally:
            await broker.close()

    def nodes(message: TopicMessage) -> Any:
        return message.data

    asyncio.run(test())


LAUNCH = """
import os, sys, types

class Declared:
    def __init__(self, name, default_value=None, description=None):
        self.name, self.default = name, default_value

class Configuration:
    def __init__(self, name):
        self.name = name

class ExecuteProcess:
    def __init__(self, cmd, name, output, respawn, respawn_delay, sigterm_timeout):
        self.cmd = cmd

class Node:
    def __init__(self, package, executable, name, parameters):
        self.program, self.name, self.parameters = f"{package}.{executable}", name, parameters

stands_in = {
    "launch": {"LaunchDescription": list},
    "launch.actions": {"DeclareLaunchArgument": Declared, "ExecuteProcess": ExecuteProcess},
    "launch.substitutions": {"LaunchConfiguration": Configuration},
    "launch_ros": {},
    "launch_ros.actions": {"Node": Node},
}
for module, names in stands_in.items():
    sys.modules[module] = types.ModuleType(module)
    sys.modules[module].__dict__.update(names)
verb, package, file, *given = sys.argv[1:]
assert (verb, package) == ("launch", "robomend_ros")
found = {}
exec(open(os.path.join(FOLDER, file)).read(), found)
parts = found["generate_launch_description"]()
values = {part.name: part.default for part in parts if isinstance(part, Declared)}
for word in given:
    name, _, value = word.partition(":=")
    assert name in values, word
    values[name] = value
for process in parts:
    if isinstance(process, ExecuteProcess):
        command = [values[one.name] for one in process.cmd]
        os.execvp(command[0], command)
[node] = [part for part in parts if isinstance(part, Node)]
set_to = [f"{name}:={values[one.name]}" for group in node.parameters for name, one in group.items()]
options = ["-r", f"__node:={node.name}", *(word for one in set_to for word in ("-p", one))]
os.execv(sys.executable, [sys.executable, "-m", node.program, "--ros-args", *options])
"""
"""`ros2 launch`, whose packages are no wheels: what is read of the launch file, and the node for real."""


def test_the_line_of_the_page_launches_the_feeder(ros: Ros2Robot) -> None:
    [block] = [block for block in BLOCKS if block.test.endswith(f"robomend_ros/{Path(__file__).name}")]
    program = ros.folder / "ros2"
    program.write_text(f"#!{KILTED.python}\nFOLDER = {str(PACKAGE / 'launch')!r}\n{LAUNCH}")
    program.chmod(0o755)
    node = ros.node("laser")
    node.do("publish", topic="/scan", type="std_msgs/String", value={"data": "x"}, rate=20, reliable=False)

    async def test() -> None:
        told: set[str] = set()
        broker = Broker("tcp:127.0.0.1:0", lambda message: told.add(message.topic))
        await broker.open()
        typed = block.text.replace("tcp:127.0.0.1:7411", broker.address)
        here = {**environment(ros), "PATH": f"{ros.folder}:{os.environ['PATH']}"}
        with (ros.folder / "feeder.log").open("ab") as log:
            process = subprocess.Popen(["bash", "-c", f"exec {typed}"], env=here, stderr=log)
        try:
            await eventually(lambda: {"scan", "nodes"} <= told, "both", 60)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)
            await broker.close()

    asyncio.run(test())


CHECKED = """
robot: r1
service: {url: "http://127.0.0.1:9"}
processes:
  driver: {command: [touch, BEGUN], start: true}
"""

AGENT = f"""#!{sys.executable}
from robomend_client.agent.main import main
main()
"""


def agent_at(folder: Path) -> dict[str, str]:
    """Put the agent's program and a file for it there; return the environment that finds it."""
    program = folder / "bin" / "robomend-agent"
    program.parent.mkdir()
    program.write_text(AGENT)
    program.chmod(0o755)
    (folder / "agent.yaml").write_text(CHECKED.replace("BEGUN", str(folder / "begun")))
    return {**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}"}


def test_the_line_of_the_page_launches_the_agent(tmp_path: Path) -> None:
    here = agent_at(tmp_path)
    program = tmp_path / "bin" / "ros2"
    program.write_text(f"#!{sys.executable}\nFOLDER = {str(PACKAGE / 'launch')!r}\n{LAUNCH}")
    program.chmod(0o755)
    line = ["ros2", "launch", "robomend_ros", "agent.launch.py", f"file:={tmp_path / 'agent.yaml'}"]
    process = subprocess.Popen(line, env=here, cwd=tmp_path)
    try:
        until((tmp_path / "begun").exists, "the agent has begun its process", 60)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def test_roslaunch_launches_the_agent(tmp_path: Path) -> None:
    why = ROSLAUNCH.install()
    if why:
        pytest.skip(why)
    here = {
        **agent_at(tmp_path),
        "ROS_MASTER_URI": f"http://127.0.0.1:{own_port()}",
        "ROS_PACKAGE_PATH": str(PACKAGE.parent),
        "ROS_HOME": str(tmp_path / "ros"),
    }
    line = ["roslaunch", "robomend_ros", "agent.launch", f"file:={tmp_path / 'agent.yaml'}"]
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(line, env=here, cwd=tmp_path, stdout=log, stderr=log)
    try:
        until((tmp_path / "begun").exists, "the agent has begun its process", 90)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def run(ros: Ros2Robot, *arguments: str) -> tuple[int, str]:
    """Run a program as the agent does, to its end."""
    program = Program("act", command(*arguments), ros.folder, environment=environment(ros))
    result = asyncio.run(program.execute(Action("a1", "act", (), 60.0), lambda *_: None))
    return result.code, result.message


def test_lifecycles_are_changed_and_goals_sent_for_the_agent_and_cancelled(ros: Ros2Robot) -> None:
    node = ros.node("host")
    node.do("lifecycle", name="camera")
    node.do("lifecycle", name="stubborn", refuses=True)
    node.do("serve", name="/count")
    node.do("serve", name="/endless", waits=True)
    assert run(ros, "lifecycle", "/camera", "configure")[0] == OK
    assert run(ros, "lifecycle", "/camera", "activate")[0] == OK
    assert [line["value"] for line in node.heard] == ["active"]
    code, said = run(ros, "lifecycle", "stubborn", "configure")
    assert (code, "stubborn refuses to configure" in said) == (FAILED, True)
    assert run(ros, "lifecycle", "camera", "explode")[0] == FAILED
    code, said = run(ros, "action", "/count", FIBONACCI, "order=3")
    assert (code, "[0, 1, 2]" in said) == (OK, True)
    assert run(ros, "action", "/count", "test_msgs/action/Nothing")[0] == FAILED
    code, said = run(ros, "action", "/count", FIBONACCI, "ordre=3")
    assert (code, "ordre" in said) == (FAILED, True)
    process = subprocess.Popen(command("action", "/endless", FIBONACCI), env=environment(ros))
    until(lambda: node.do("asked") == 2, "the goal", 60)
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == FAILED
    until(lambda: node.heard[-1]["value"] == "cancelled", "the cancellation", 60)


def test_it_is_written_for_python_3_8_and_packed_for_colcon() -> None:
    for file in PACKAGE.rglob("*.py"):
        ast.parse(file.read_text(), str(file), feature_version=(3, 8))
    assert ElementTree.parse(PACKAGE / "package.xml").findtext("name") == "robomend_ros"
    setup = (PACKAGE / "setup.py").read_text()
    for program in ("feeder", "lifecycle", "action"):
        assert f'"{program} = robomend_ros.{program}:main"' in setup
        assert "def main(" in (PACKAGE / "robomend_ros" / f"{program}.py").read_text()
    assert (PACKAGE / "resource" / "robomend_ros").is_file()
    for name in ("agent", "feeder"):
        assert f"launch/{name}.launch.py" in setup
        assert (PACKAGE / "launch" / f"{name}.launch.py").is_file()
