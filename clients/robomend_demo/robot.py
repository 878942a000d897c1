"""A simulated robot from its component model: what devices.py, nodes.py and robomend-agent are configured
with.

Everything is a value; who runs the demo writes them as JSON files (JSON is YAML, so the agent reads it too).
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robomend.model.components import ComponentModel

RATE_HZ = 10.0
TOLERANCE_HZ = 3.0
"""Wider than the model's: that this computer is busy is no fault of the robot.

Over the five intervals that make a topic ok, one message that is 60 ms late already is 1 Hz.
"""


def devices_config(model: ComponentModel, boot_s: float = 0.0) -> dict[str, Any]:
    """Return the configuration of devices.py: every hardware of the model, with its channel."""
    devices = {name: {"channel": hardware.channel} for name, hardware in model.hardware.items()}
    return {"rate_hz": RATE_HZ, "boot_s": boot_s, "devices": devices}


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
    key_file: Path | None = None,
    agent: str = "onboard",
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
    service: dict[str, str] = {"url": service_url}
    if key_file is not None:
        service["key_file"] = str(key_file)
    actions = {"switch_to_spare": _switch(nodes_file, spares)} if spares else {}
    return {
        "robot": robot,
        "agent": agent,
        "service": service,
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
