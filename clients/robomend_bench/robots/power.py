"""The paper's two scenarios on its robot, with nodes of a real ROS: power-up and shut-down.

    power board, emulated ──► devices, simulated ──TCP──► drivers ──ROS──► other nodes
            ▲                                                └───────ROS───────┴──► agent ──► service
            └───────────────────────────── power_up ◄────────────────────────────────────────────┘

A driver connects to its device once, when it starts, and is mute from when the device loses its power until
it is restarted, as in the paper. The agent starts and stops the nodes, and hears their topics over ROS.

The time runs from when the robot is entrusted to the service, or its base loses its power, until the service
calls it repaired, which it does when all that its observers see is as it should be.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

from robomend.model.components import ComponentModel
from robomend.model.loading import load_model
from robomend.resources import resource
from robomend_bench.robots.live import WITHIN_S, NotTold, Watcher
from robomend_bench.robots.ros import Ros, line, started
from robomend_client.events import Kind

MODEL = "tedusar.yaml"
OBSERVED_TOPICS = ("odom", "map", "scan", "imu_data", "cmd_vel")
"""As in the paper: what its general observers watch."""

COMPUTER = 2
"""The channel that feeds the robot's own computer."""

VICTIM = "jaguar"
"""The tracked base, which loses its power."""

RATE_HZ, TOLERANCE_HZ = 10.0, 3.0
"""That this computer is busy is no fault of the robot: as in the demo."""

ENDED = ("unconfirmed", "escalated", "cancelled", "failed")

NODE = """
import json, os, socket, sys, threading, time
name, spec = sys.argv[1], json.loads(sys.argv[2])
start(name)
outputs = {topic: publisher("/" + topic) for topic in spec["publishes"]}
def publish(topics):
    for topic in topics:
        outputs[topic]()
def drive(readings):
    try:
        for _ in readings:
            publish(outputs)
    except OSError:
        pass
def beat():
    due = time.monotonic()
    while True:
        publish(outputs)
        due += 0.1
        time.sleep(max(0, due - time.monotonic()))
if spec["devices"]:
    try:
        found = [socket.create_connection(device, 1) for device in spec["devices"]]
    except OSError:
        found = []
    for device in found:
        device.settimeout(None)
    if found:
        threading.Thread(target=drive, args=(found[0].makefile(),), daemon=True).start()
elif spec["publishes"] and not any(spec["publishes"].values()):
    threading.Thread(target=beat, daemon=True).start()
else:
    for topic, inputs in spec["publishes"].items():
        listen("/" + inputs[0], lambda topic=topic: publish([topic]))
told = os.environ.get("NOTIFY_SOCKET")
if told:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ready:
        ready.sendto(b"READY=1", "\\0" + told[1:] if told[0] == "@" else told)
spin()
"""


class PowerRig(Watcher):
    """The paper's robot, all of it off, and who listens to the service."""

    def __init__(self, url: str, folder: Path, ros: Ros, stack: ExitStack) -> None:
        """Start board and devices, which end with the stack, and tell the service of the robot."""
        super().__init__(url, "tedusar", Kind.REPAIR)
        file = resource("examples", MODEL)
        model = load_model(file).parts
        assert model is not None
        self.model: ComponentModel = model
        self._url = url
        self._folder = folder
        self._ros, self._network = ros, ros.network(folder, stack)
        module = [sys.executable, "-m"]
        ports = ["--port", "0", "--control-port", "0", "--on", str(COMPUTER)]
        opened = json.loads(line(started([*module, "robomend_board.main", *ports], os.environ, stack)))
        self._control_port = int(opened["control_port"])
        devices = folder / "devices.json"
        channels = {name: {"channel": device.channel} for name, device in model.hardware.items()}
        devices.write_text(json.dumps({"rate_hz": RATE_HZ, "devices": channels}))
        control = ["--config", str(devices), "--control", f"127.0.0.1:{self._control_port}"]
        there = json.loads(line(started([*module, "robomend_demo.devices", *control], os.environ, stack)))
        self._devices: dict[str, str] = there["devices"]
        powered = [f"on({name})" for name, device in model.hardware.items() if device.channel is not None]
        self._observed = [*powered, *map("running({})".format, model.nodes)]
        self._observed += map("ok({})".format, OBSERVED_TOPICS)
        self._config = {
            "model": model.name,
            "observed": self._observed,
            "board": {"host": "127.0.0.1", "port": opened["port"], "rate_hz": 5, "protected": [COMPUTER]},
        }
        self.client.put_model(model.name, file.read_text(encoding="utf-8"))
        self._version = self.client.put_robot("tedusar", {**self._config, "policy": "observe"}).version
        self.listen()

    def agent(self) -> AbstractContextManager[subprocess.Popen[bytes]]:
        """Run the agent; it is known then that no node runs."""
        off = {f"running({node})": False for node in self.model.nodes}
        return self.running(self._folder, self._settings(), off)

    def power_up_s(self) -> float:
        """Entrust the robot to the service; return how long it took until it was repaired."""
        return self._repaired_s(
            lambda: self.client.put_robot("tedusar", {**self._config, "policy": "auto"}, self._version)
        )

    def shut_down_s(self) -> float:
        """Take the power of the robot's base; return how long it took until it was repaired."""
        channel = self.model.hardware[VICTIM].channel
        request = json.dumps({"set": {"channel": channel, "on": False}})

        def cut() -> None:
            with socket.create_connection(("127.0.0.1", self._control_port), WITHIN_S) as control:
                control.sendall(request.encode() + b"\n")
                if not json.loads(control.makefile().readline()).get("ok"):
                    raise NotTold(f"the board did not do {request}")

        return self._repaired_s(cut)

    def _repaired_s(self, happens: Callable[[], object]) -> float:
        """Let something happen; return how long it took until the service called the robot repaired.

        Raises:
            NotTold: it did not, or something that is observed is not as it should be then.
        """
        began_ns = time.time_ns()
        happens()
        deadline = time.monotonic() + WITHIN_S
        while (event := self._next(deadline)) is not None:
            repair = event.data
            if event.kind is not Kind.REPAIR or repair["created_ns"] < began_ns:
                continue
            if repair["state"] in ENDED:
                raise NotTold(f"the repair ended as {repair['state']}: {repair['reason']}")
            if repair["state"] == "repaired":
                self.told(dict.fromkeys(self._observed, True))
                return float(repair["finished_ns"] - began_ns) / 1e9
        raise NotTold(f"no repair within {WITHIN_S:g} s")

    def _settings(self) -> Mapping[str, Any]:
        """Return the agent's file."""
        origin = self._ros.origin
        watched = {"rate_hz": RATE_HZ, "tolerance_hz": TOLERANCE_HZ}
        return {
            "robot": "tedusar",
            "service": {"url": self._url},
            "bus": {"listen": "tcp:127.0.0.1:0"},
            origin: self._network.section,
            "rate": {"from": origin},
            "topics": dict.fromkeys(OBSERVED_TOPICS, watched),
            "processes": {node: self._process(node) for node in self.model.nodes},
        }

    def _process(self, name: str) -> Mapping[str, Any]:
        node = self.model.nodes[name]
        spec = {
            "devices": [self._devices[device].rsplit(":", 1) for device in node.drives],
            "publishes": {topic: list(inputs) for topic, inputs in node.publishes.items()},
        }
        changed = {
            key: value for key, value in self._network.environment.items() if os.environ.get(key) != value
        }
        return {
            "command": [self._network.python, "-c", self._ros.words + NODE, name, json.dumps(spec)],
            "environment": changed,
            "ready": "notify",
            "start_timeout_s": 30,
        }
