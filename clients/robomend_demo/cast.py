"""Everything that plays in the demo, as processes that talk over loopback: started, wired, ready.

    robomend serve ◄──HTTP── robomend-agent ──► nodes ──► devices ◄──control port── robomend-board
          └───────────────────────board protocol, 5 Hz────────────────────────────────────┘

Ports are free ones, chosen by the system; whoever opens a port announces it. Files live in one folder.
"""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomend.cli.interrupts import Interrupts
from robomend.cli.stage import Actor, PartFailed, Stage, python, tail
from robomend.model.components import ComponentModel
from robomend.model.loading import load_model
from robomend.resources import resource
from robomend_client.rest.sync import Client
from robomend_demo.devices import DeviceFault

# --- A simulated robot from its component model: what devices.py, nodes.py and robomend-agent are configured
# with.
#
# Everything is a value; who runs the demo writes them as JSON files (JSON is YAML, so the agent reads it
# too).

RATE_HZ = 10.0
TOLERANCE_HZ = 3.0
"""Wider than the model's: that this computer is busy is no fault of the robot.

Over the five intervals that make a topic ok, one message that is 60 ms late already is 1 Hz.
"""


def devices_config(model: ComponentModel) -> dict[str, Any]:
    """Return the configuration of devices.py: every hardware of the model, with its channel."""
    devices = {name: {"channel": hardware.channel} for name, hardware in model.hardware.items()}
    return {"rate_hz": RATE_HZ, "devices": devices}


def nodes_config(model: ComponentModel, addresses: dict[str, str], startup_s: float = 0.2) -> dict[str, Any]:
    """Return the configuration of nodes.py; `addresses` is what devices.py printed when it was ready."""
    nodes = {
        name: {
            "drives": list(node.drives),
            "publishes": {topic: list(inputs) for topic, inputs in node.publishes.items()},
        }
        for name, node in model.nodes.items()
    }
    return {"startup_s": startup_s, "rate_hz": RATE_HZ, "devices": dict(addresses), "nodes": nodes}


def agent_config(
    model: ComponentModel,
    robot: str,
    service_url: str,
    nodes_file: Path,
    state_dir: Path,
    start_nodes: bool = False,
    spares: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return the agent's configuration: the model's nodes as processes, its topics to be watched.

    `spares`: device -> the one that can stand in for it; then `switch_to_spare` is an action of the agent's.

    The observers are those of the demo: checked every 0.1 s, ok after 5 intervals within tolerance, not ok
    after 0.5 s of silence. The rate is measured over up to 10 intervals, so that one late message does no
    harm once it is ok.
    """
    topics = {topic for node in model.nodes.values() for topic in node.publishes}
    expected = {name: model.topics.get(name) for name in sorted(topics)}
    actions = {"switch_to_spare": _switch(nodes_file, spares)} if spares else {}
    return {
        "robot": robot,
        "agent": "onboard",
        "service": {"url": service_url},
        "state_dir": str(state_dir),
        "report": {"heartbeat_s": 1.0, "lifetime_s": 5.0},
        "rate": {"window": 11, "settle": 5, "silence_s": 0.5, "check_s": 0.1},
        "topics": {
            name: {
                "rate_hz": (topic.rate_hz if topic else None) or RATE_HZ,
                "tolerance_hz": max((topic.tolerance_hz if topic else None) or 1.0, TOLERANCE_HZ),
            }
            for name, topic in expected.items()
        },
        "actions": actions,
        "processes": {
            name: {
                "command": [
                    sys.executable,
                    "-m",
                    "robomend_demo.nodes",
                    "--name",
                    name,
                    "--config",
                    str(nodes_file),
                ],
                "ready": "notify",
                "start_timeout_s": 5.0,
                "stop_grace_s": 1.0,
                "start": start_nodes,
            }
            for name in model.nodes
        },
    }


def _switch(nodes_file: Path, spares: Mapping[str, str]) -> dict[str, Any]:
    """Return the action that lets drivers find another device where theirs was: spare.py."""
    command = [sys.executable, "-m", "robomend_demo.spare", str(nodes_file), "{device}", "{spare}"]
    parameters = {"device": sorted(spares), "spare": sorted(spares.values())}
    return {"kind": "process", "command": command, "parameters": parameters}


ROBOT = "tedusar"
PC_CHANNEL = 2
BOARD_HZ = 5
READY_S = 120.0
"""For each process to say that it is ready: a bare machine compiles its Python files first, which takes more
than 30 s of a very busy one. One that ends instead is told at once."""

CONTROL_S = 5.0

GENERAL_OBSERVERS = ("odom", "map", "scan", "imu_data", "cmd_vel")
"""Topics whose rate is watched, as in the paper (section VI): its general observers."""


@dataclass(frozen=True, slots=True)
class Board:
    """Where the emulated power board is."""

    port: int
    control_port: int

    def set_channel(self, channel: int, on: bool) -> None:
        """Move a relay although no client asked: power lost, or given back.

        Raises:
            PartFailed: the emulator did not do it.
        """
        _ask("the board emulator", self.control_port, {"set": {"channel": channel, "on": on}})


@dataclass(frozen=True, slots=True)
class Devices:
    """Where the simulated devices are."""

    addresses: dict[str, str]  # name -> address
    fault_port: int

    def plant(self, device: str, fault: DeviceFault) -> None:
        """Let something be wrong with a device.

        Raises:
            PartFailed: the simulation did not do it.
        """
        _ask("the simulation of the devices", self.fault_port, {"device": device, "fault": fault})


@dataclass(frozen=True, slots=True)
class Cast:
    """The parts, ready."""

    robot: DemoRobot
    url: str
    board: Board
    devices: Devices
    actors: dict[str, Actor]


@dataclass(frozen=True, slots=True)
class DemoRobot:
    """Which robot plays: its model, and what it has beside."""

    model: ComponentModel
    source: str  # the model's text
    domain: str | None = None  # PDDL beside or in place of the service's own
    hold_s: float = 0.0  # how long a diagnosis must hold
    spares: Mapping[str, str] = field(default_factory=dict)  # device -> who can stand in for it


def tedusar() -> DemoRobot:
    """Return the paper's robot."""
    return DemoRobot(*_model("tedusar.yaml"))


def tedusar_with_spare() -> DemoRobot:
    """Return the paper's robot with a second laser range finder."""
    domain = resource("examples/actions", "spare_hokuyo.pddl").read_text(encoding="utf-8")
    return DemoRobot(*_model("tedusar_spare.yaml"), domain, spares={"hokuyo": "hokuyo_b"})


def _model(name: str) -> tuple[ComponentModel, str]:
    path = resource("examples", name)
    model = load_model(path).parts
    assert model is not None
    return model, path.read_text(encoding="utf-8")


def observed(model: ComponentModel) -> list[str]:
    """Return what the observers will report: switchable devices, nodes, and the watched topics."""
    switchable = [f"on({name})" for name, device in model.hardware.items() if device.channel is not None]
    running = [f"running({node})" for node in model.nodes]
    return [*switchable, *running, *(f"ok({topic})" for topic in GENERAL_OBSERVERS)]


def robot_config(robot: DemoRobot, board: Board, *, policy: str) -> dict[str, Any]:
    """Return the robot as the service is told of it."""
    return {
        "model": robot.model.name,
        "policy": policy,
        "observed": observed(robot.model),
        "observed_timeout_s": 15.0,
        "hold_s": robot.hold_s,
        "board": {
            "host": "127.0.0.1",
            "port": board.port,
            "rate_hz": BOARD_HZ,
            "protected": [PC_CHANNEL],
        },
        # Somebody who plays with --hold takes the power away more often than a robot loses it.
        "limits": {"attempts_per_hour": 200},
        "domain": robot.domain,
        # To point a driver at the spare twice is to do it once.
        "actions": {"switch_to_spare": {"idempotent": True}} if robot.spares else {},
    }


def gather(stage: Stage, folder: Path, robot: DemoRobot, *, all_on: bool) -> Cast:
    """Start all parts; the agent is started by `start_agent`, once the robot is known to the service.

    Args:
        all_on: whether the robot's channels are on from the beginning.

    Raises:
        PartFailed: a part did not become ready, with the end of its log.
    """
    model = robot.model
    channels = {device.channel for device in model.hardware.values() if device.channel is not None}
    on = sorted({PC_CHANNEL} | (channels if all_on else set()))
    data = folder / "data"
    serve = python("robomend", "serve", "--port", "0", "--data", str(data), "--announce")
    service = stage.start("service", serve, announces=True)
    ports = ["--port", "0", "--control-port", "0", "--on", ",".join(map(str, on))]
    board = stage.start("board", python("robomend_board.main", *ports, "--end-with-parent"), announces=True)
    opened = stage.announced(board, READY_S)
    at = Board(opened["port"], opened["control_port"])
    devices_file = _write(folder / "devices.json", devices_config(model))
    control = ["--control", f"127.0.0.1:{at.control_port}", "--end-with-parent"]
    simulate = python("robomend_demo.devices", "--config", str(devices_file), *control)
    devices = stage.start("devices", simulate, announces=True)
    there = stage.announced(devices, READY_S)
    url = str(stage.announced(service, READY_S)["url"])
    actors = {"service": service, "board": board, "devices": devices}
    with Client(url, timeout_s=10.0) as client:
        client.put_model(model.name, robot.source)
    return Cast(robot, url, at, Devices(there["devices"], there["fault_port"]), actors)


def start_agent(stage: Stage, folder: Path, cast: Cast, *, start_nodes: bool) -> None:
    """Start the robot's agent, which starts and watches the nodes."""
    robot = cast.robot
    nodes_file = _write(folder / "nodes.json", nodes_config(robot.model, cast.devices.addresses))
    config = agent_config(
        robot.model,
        ROBOT,
        cast.url,
        nodes_file,
        folder / "agent",
        start_nodes=start_nodes,
        spares=robot.spares,
    )
    config["bus"] = {"listen": "tcp:127.0.0.1:0"}  # the folder's path may be too long for a Unix socket
    file = _write(folder / "agent.json", config)
    cast.actors["agent"] = stage.start("agent", python("robomend_client.agent.main", str(file)))


def wait_for_devices(cast: Cast, interrupts: Interrupts, timeout_s: float) -> None:
    """Wait until every device takes connections: the drivers look for theirs once, when they start.

    Raises:
        PartFailed: one is not there in time.
    """
    missing = set(cast.devices.addresses)
    look = interrupts.poll(timeout_s)
    while missing and look.left():
        missing = {name for name in missing if not _accepts(cast.devices.addresses[name])}
    if missing:
        log = tail(cast.actors["devices"].log)
        raise PartFailed(
            f"the simulated {', '.join(sorted(missing))} took no connection within {timeout_s:g} s; "
            f"the devices' log ends:\n{log}"
        )


def _ask(whom: str, port: int, request: Mapping[str, Any]) -> None:
    """Send a line of JSON to a control port of ours, and wait for its answer.

    Raises:
        PartFailed: there is none, or it says no.
    """
    try:
        with socket.create_connection(("127.0.0.1", port), CONTROL_S) as connection:
            connection.sendall(json.dumps(request).encode() + b"\n")
            answer = json.loads(connection.makefile().readline() or '{"error": "it hung up"}')
    except OSError as error:
        raise PartFailed(f"{whom} does not answer: {error}") from error
    if not answer.get("ok"):
        raise PartFailed(f"{whom} did not do {json.dumps(request)}: {answer.get('error')}")


def _accepts(address: str) -> bool:
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), 1.0).close()
    except OSError:
        return False
    return True


def _write(file: Path, value: dict[str, Any]) -> Path:
    file.write_text(json.dumps(value, indent=2))
    return file
