"""The paper's robot, whole: board emulator, devices, agent, nine node processes; the service is a double."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.clients.running_agent import agent, marked
from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.robomend_board.processes import Control, running
from tests.robomend_demo.test_devices import devices

from robomend.model.components import ComponentModel
from robomend.model.loading import load_model
from robomend_client.agent.config import load
from robomend_demo.cast import agent_config, devices_config, nodes_config

TEDUSAR = Path(__file__).parents[2] / "examples" / "tedusar.yaml"
SWITCHED = {"laser_alignment": 1, "hokuyo": 3, "jaguar": 7}


def observed_by_agent(model: ComponentModel) -> list[str]:
    """Return what the agent will report."""
    topics = sorted({topic for node in model.nodes.values() for topic in node.publishes})
    return [*(f"ok({topic})" for topic in topics), *(f"running({node})" for node in model.nodes)]


@dataclass
class Robot:
    model: ComponentModel
    service: ServiceDouble
    board: Control
    agent: subprocess.Popen[bytes]
    folder: Path

    def holds(self, *literals: str) -> bool:
        now = self.service.holds()
        return all(
            now.get(literal.removeprefix("not ")) is (not literal.startswith("not ")) for literal in literals
        )

    def eventually(self, *literals: str) -> None:
        eventually(lambda: self.holds(*literals), " and ".join(literals))

    def power(self, on: bool, *devices: str) -> None:
        for device in devices:
            assert self.board.ask(set={"channel": SWITCHED[device], "on": on}) == {"ok": True}

    def start(self, *nodes: str) -> None:
        """Start nodes side by side, as a plan's independent actions are."""
        for node in nodes:
            self.service.ask(f"{id(nodes)}:{node}", "start_node", node)
        for node in nodes:
            eventually(lambda node=node: self.service.result(f"{id(nodes)}:{node}"), f"a result of {node}")  # type: ignore[misc]  # bound for this round
            result = self.service.result(f"{id(nodes)}:{node}")
            assert result is not None
            assert result["code"] == 0, result


def tedusar() -> ComponentModel:
    model = load_model(TEDUSAR).parts
    assert model is not None
    return model


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    model = tedusar()
    with ExitStack() as stack:
        service = stack.enter_context(service_double())
        board = stack.enter_context(running("--on", "2"))
        control = f"127.0.0.1:{board.control_port}"
        _, addresses = stack.enter_context(devices(tmp_path, devices_config(model), control))
        nodes_file = tmp_path / "nodes_of_robot.json"
        where = {name: f"{host}:{port}" for name, (host, port) in addresses.items()}
        nodes_file.write_text(json.dumps(nodes_config(model, where)))
        file = tmp_path / "agent.yaml"
        file.write_text(
            json.dumps(agent_config(model, "tedusar", service.url, nodes_file, tmp_path / "state"))
        )
        process = stack.enter_context(agent(file))
        with Control(board.control_port) as said:
            yield Robot(model, service, said, process, tmp_path)
    assert marked(str(nodes_file)) == []


NODES = (
    "jaguar_node",
    "hokuyo_node",
    "laser_alignment_node",
    "imu_node",
    "joy_node",
    "jaguar_teleop_node",
    "hector_mapping",
    "rviz",
    "laser_alignment_control",
)


def test_everything_configured_is_reported_once_even_when_all_is_off(robot: Robot) -> None:
    expected = set(observed_by_agent(robot.model))
    eventually(lambda: set(robot.service.holds()) == expected, "a literal of each observer")
    assert not any(robot.service.holds().values())


def test_power_up_then_lost_power_then_a_restart_as_in_the_paper(robot: Robot) -> None:
    robot.power(True, *SWITCHED)
    robot.start(*NODES)
    robot.eventually(*observed_by_agent(robot.model))

    robot.power(False, "jaguar")
    robot.eventually("not ok(odom)", "running(jaguar_node)", "ok(scan)", "ok(map)")

    robot.power(True, "jaguar")
    told = len(robot.service.batches())
    eventually(lambda: len(robot.service.batches()) >= told + 2, "two heartbeats with the power on")
    assert robot.holds("not ok(odom)", "running(jaguar_node)")  # mute until it is restarted

    assert robot.service.do("restart:1", "stop_node", "jaguar_node")["code"] == 0
    robot.eventually("not running(jaguar_node)")
    robot.start("jaguar_node")
    robot.eventually(*observed_by_agent(robot.model))


def test_what_rests_on_a_killed_node_is_not_ok_either(robot: Robot) -> None:
    robot.power(True, "hokuyo")
    robot.start("hokuyo_node", "hector_mapping")
    robot.eventually("ok(scan)", "ok(map)")
    (laser,) = (pid for pid in marked(str(robot.folder)) if b"hokuyo_node" in _command(pid))
    os.kill(laser, signal.SIGKILL)
    robot.eventually("not running(hokuyo_node)", "not ok(scan)", "not ok(map)", "running(hector_mapping)")


def test_kill_9_of_the_agent_leaves_no_node_behind(robot: Robot) -> None:
    robot.start("imu_node", "joy_node", "rviz")
    robot.agent.kill()
    robot.agent.wait()
    eventually(lambda: not [pid for pid in marked("robomend_demo.nodes") if _of(robot, pid)], "no node")


def test_the_configuration_that_is_made_of_the_model_is_one_that_the_agent_takes(tmp_path: Path) -> None:
    file = tmp_path / "agent.yaml"
    made = agent_config(tedusar(), "r", "http://127.0.0.1:1", tmp_path / "nodes.json", tmp_path / "state")
    file.write_text(json.dumps(made))
    config = load(file)
    assert {spec.name for spec in config.processes} == set(NODES)
    assert {name for name, _ in config.topics} == {"odom", "scan", "imu_data", "joy", "cmd_vel", "map"}
    assert {(rate.check_s, rate.silence_s, rate.intervals) for _, rate in config.topics} == {(0.1, 0.5, 5)}


def _command(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


def _of(robot: Robot, pid: int) -> bool:
    try:
        return str(robot.folder).encode() in _command(pid)
    except OSError:
        return False
