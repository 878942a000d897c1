"""A robot on which drills are carried out for real: service, power board, devices, agent and nodes.

Each part can be killed and started again, at the same address and on the same files.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.clients.running_agent import alive, halted
from tests.forked import popen
from tests.network import own_port
from tests.repairs.robot import MODEL as SMALL
from tests.waiting import look_s, until

from robomend.model.components import ComponentModel
from robomend.model.loading import load_text
from robomend_client.rest import Client, ClientError
from robomend_client.rest.errors import StateConflict
from robomend_client.rest.retry import NEVER
from robomend_demo.cast import RATE_HZ, agent_config, devices_config, nodes_config

MODEL = f"""{SMALL}\
  logger: {{protected: true}}
topics:
  odom: {{rate_hz: 10}}
  scan: {{rate_hz: 10}}
  map: {{rate_hz: 10}}
"""

WAIT_S = 60.0


@dataclass
class DrilledRobot:
    """See the module."""

    folder: Path
    source: str = MODEL
    keep: bool = False
    unwatched: frozenset[str] = frozenset()  # topics that no observer watches
    config: dict[str, Any] = field(default_factory=dict)
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    port: int = 0
    board: dict[str, int] = field(default_factory=dict)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def model(self) -> ComponentModel:
        parts = load_text(self.source).parts
        assert parts is not None
        return parts

    @property
    def client(self) -> Client:
        return Client(self.url, retry=NEVER, timeout_s=20.0)

    # --- processes

    def _start(self, name: str, *arguments: str, announces: bool = True) -> dict[str, Any]:
        with (self.folder / f"{name}.log").open("ab") as log:
            process = popen(
                [sys.executable, "-m", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if announces else log,
                stderr=log,
                start_new_session=True,
            )
        self.processes[name] = process
        if not announces:
            return {}
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line, f"{name}: {(self.folder / f'{name}.log').read_text()[-2000:]}"
        found: dict[str, Any] = json.loads(line)
        return found

    def start_service(self) -> None:
        data = str(self.folder / "data")
        opened = self._start(
            "service", "robomend", "serve", "--port", str(self.port), "--data", data, "--announce"
        )
        self.port = int(opened["url"].rpartition(":")[2])

    def start_agent(self) -> None:
        self._start("agent", "robomend_client.agent.main", str(self.folder / "agent.json"), announces=False)

    def start(self) -> None:
        """Start all of it, and wait until the robot is healthy."""
        model = self.model
        channels = sorted(d.channel for d in model.hardware.values() if d.channel is not None)
        on = ",".join(map(str, {2, *channels}))
        self.board = self._start(
            "board", "robomend_board.main", "--port", "0", "--control-port", "0", "--on", on
        )
        (self.folder / "devices.json").write_text(json.dumps(devices_config(model)))
        devices = self._start(
            "devices",
            "robomend_demo.devices",
            *("--config", str(self.folder / "devices.json")),
            *("--control", f"127.0.0.1:{self.board['control_port']}"),
        )
        self.start_service()
        nodes = self.folder / "nodes.json"
        nodes.write_text(json.dumps(nodes_config(model, devices["devices"], 0.0)))
        agent = agent_config(model, "r1", self.url, nodes, self.folder / "agent", start_nodes=True)
        bus = f"tcp:127.0.0.1:{own_port() if self.keep else 0}"  # kept nodes look for it where it was
        agent |= {"bus": {"listen": bus}, "when_agent_ends": "keep" if self.keep else "stop"}
        # That this computer is busy is no fault of the robot, nor of its agent: only silence is.
        agent["rate"] |= {"silence_s": 1.5}
        agent["report"] |= {"lifetime_s": 10.0}
        agent["topics"] = {name: one for name, one in agent["topics"].items() if name not in self.unwatched}
        for topic in agent["topics"].values():
            topic |= {"rate_hz": RATE_HZ, "tolerance_hz": RATE_HZ - 1.0}
        (self.folder / "agent.json").write_text(json.dumps(agent))
        with self.client as client:
            client.put_model(model.name, self.source)
            client.put_robot("r1", self.robot_config())
        self.start_agent()
        self.until_healthy()

    def robot_config(self) -> dict[str, Any]:
        model = self.model
        published = {topic for node in model.nodes.values() for topic in node.publishes}
        observed = [f"on({name})" for name, one in model.hardware.items() if one.channel is not None]
        observed += [f"running({name})" for name in model.nodes]
        observed += [f"ok({topic})" for topic in sorted(published - self.unwatched)]
        return {
            "model": model.name,
            "policy": "auto",
            "observed": observed,
            "observed_timeout_s": 15.0,
            "board": {
                "host": "127.0.0.1",
                "port": self.board["port"],
                "control_port": self.board["control_port"],
                "rate_hz": 5,
                "protected": [2],
            },
            **self.config,
        }

    def configure(self, **changes: Any) -> None:
        with self.client as client:
            found = client.robot("r1")
            client.put_robot("r1", {**found.value["config"], **changes}, found.version)

    def kill(self, name: str) -> None:
        """kill -9; what it leaves behind is its own business."""
        process = self.processes.pop(name)
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()

    def close(self) -> None:
        for name in ("agent", "service", "devices", "board"):
            process = self.processes.pop(name, None)
            if process is None:
                continue
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        for pid in self.nodes().values():  # kept ones outlive their agent
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def nodes(self) -> dict[str, int]:
        """Return the live process of each node."""
        config = str(self.folder / "nodes.json").encode()
        found = {}
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError):
                words = (entry / "cmdline").read_bytes().split(b"\0") if entry.name.isdigit() else []
                if config in words and alive(int(entry.name)):
                    found[words[words.index(b"--name") + 1].decode()] = int(entry.name)
        return found

    def halted(self) -> list[str]:
        """Return the nodes whose process is halted."""
        return [name for name, pid in self.nodes().items() if halted(pid)]

    # --- the robot, as the service has it

    def until_healthy(self) -> None:
        until(lambda: self.state().get("state") == "healthy", f"healthy: {self.state()}", WAIT_S)

    def state(self) -> dict[str, Any]:
        """Return the robot's resource, or nothing while the service does not answer."""
        try:
            with self.client as client:
                return client.robot("r1").value
        except ClientError:
            return {}

    def start_drill(
        self,
        fault: str,
        component: str | None = None,
        bound_s: float = 60.0,
        detect_s: float = 15.0,
        topic: str | None = None,
    ) -> dict[str, Any]:
        """Begin a drill as soon as the robot is well, and no repair of it goes on; once more where it was not
        well for long enough.
        """
        deadline = time.monotonic() + WAIT_S
        while True:
            try:
                with self.client as client:
                    drill = client.start_drill(
                        "r1", fault, component, topic=topic, bound_s=bound_s, detect_s=detect_s
                    )
            except StateConflict:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)
                continue
            begun = self.drill(drill["id"], lambda one: one["state"] != "waiting")
            if begun["state"] != "refused" or time.monotonic() > deadline:
                return drill

    def drill(
        self, drill: str, wanted: Callable[[dict[str, Any]], bool], timeout_s: float = 120.0
    ) -> dict[str, Any]:
        """Return a drill once it is as wanted; the service may be away in between."""
        seen: dict[str, Any] = {}
        began = looked = time.monotonic()
        while looked - began < timeout_s:
            with contextlib.suppress(ClientError), self.client as client:
                seen = client.drill(drill)
            if seen and wanted(seen):
                return seen
            now = time.monotonic()
            time.sleep(look_s(now - began, now - looked))  # until the next look
            looked = time.monotonic()
        raise AssertionError(f"waited {timeout_s} s; the drill is {seen}")

    def ended(self, drill: str) -> dict[str, Any]:
        return self.drill(drill, lambda one: one["finished_ns"] is not None)

    def in_state(self, drill: str, *states: str) -> dict[str, Any]:
        return self.drill(drill, lambda one: one["state"] in states)

    def cancelled(self, drill: str) -> dict[str, Any]:
        """Cancel a drill, and return it when it has ended."""
        with self.client as client:
            client.decide_drill(drill, "cancel")
        ended = self.ended(drill)
        assert ended["state"] == "cancelled", ended
        return ended

    def blamed(self) -> list[list[str]]:
        """Return what each diagnosis of now blames."""
        with self.client as client:
            result = client.diagnosis("r1")["result"]
        return [one["bad"] for one in result["diagnoses"]] if result else []

    def held(self) -> set[str]:
        """Return the literals that the service holds."""
        with self.client as client:
            return {one["literal"] for one in client.observations("r1")["observations"]}

    def board_faults(self) -> list[dict[str, Any]]:
        """Return the faults of the emulated board."""
        with socket.create_connection(("127.0.0.1", self.board["control_port"]), 10.0) as connection:
            connection.sendall(b'{"status": true}\n')
            faults: list[dict[str, Any]] = json.loads(connection.makefile().readline())["faults"]
            return faults

    def leftovers(self) -> list[str]:
        """Return what is not as it was: nodes that do not run or are halted, devices that are off, faults of
        the board, leases.
        """
        found = [f"{name} does not run" for name in self.model.nodes.keys() - self.nodes().keys()]
        found += [f"{name} is halted" for name in self.halted()]
        with self.client as client:
            for channel in client.board("r1")["channels"]:
                if channel["component"] is not None and channel["on"] is not True:
                    found.append(f"{channel['component']} is off")
            found += [
                f"drill {one['id']} is open" for one in client.drills("r1")["items"] if not one["finished_ns"]
            ]
        found += [f"the board has {fault}" for fault in self.board_faults()]
        leases = self.folder / "agent" / "planted.json"
        if leases.exists() and json.loads(leases.read_text())["faults"]:
            found.append(leases.read_text())
        return found


@contextmanager
def drilled_robot(folder: Path, **more: Any) -> Iterator[DrilledRobot]:
    """Run a robot; everything is gone afterwards."""
    robot = DrilledRobot(folder, **more)
    try:
        robot.start()
        yield robot
    finally:
        robot.close()
