"""The diagnosis under the real aggregator of ROS, as rqt_robot_monitor would show it."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

import pytest
from tests.clients.running_agent import agent, config
from tests.packages import AGGREGATOR, AGGREGATOR_LIBRARY, AGGREGATOR_NODE
from tests.ros1 import Robot
from tests.service.test_ros1 import DIAGNOSTICS, heard, observed_robot
from tests.waiting import until

PACKAGE = """
<package>
  <name>diagnostic_aggregator</name>
  <export><diagnostic_aggregator plugin="${prefix}/plugins.xml"/></export>
  <run_depend>pluginlib</run_depend>
</package>
"""
PLUGINS = """
<library path="libdiagnostic_aggregator">
  <class name="diagnostic_aggregator/GenericAnalyzer" type="diagnostic_aggregator::GenericAnalyzer"
         base_class_type="diagnostic_aggregator::Analyzer"/>
</library>
"""
ANALYZERS = {
    "robomend": {
        "type": "diagnostic_aggregator/GenericAnalyzer",
        "path": "robomend",
        "startswith": ["robomend"],
        "timeout": 5.0,
    }
}
OK, WARN, ERROR, STALE = range(4)

BUSY = {"tolerance_hz": 8, "silence_s": 3}
"""What a publisher on a busy computer may do: the aggregator tells once a second what holds then."""


@contextmanager
def aggregator(ros: Robot, folder: Path) -> Iterator[None]:
    """Run it. Its analyzers are plugins; only its package for builds has their description."""
    share, lib = folder / "ros" / "share" / "diagnostic_aggregator", folder / "ros" / "lib"
    share.mkdir(parents=True)
    lib.mkdir()
    (share / "package.xml").write_text(PACKAGE)
    (share / "plugins.xml").write_text(PLUGINS)
    (lib / "libdiagnostic_aggregator.so").symlink_to(AGGREGATOR_LIBRARY)
    with ServerProxy(ros.master.uri) as master:
        master.setParam("/test", "/diagnostic_aggregator/analyzers", ANALYZERS)
    here = {"ROS_PACKAGE_PATH": f"{folder}/ros/share:/usr/share", "CMAKE_PREFIX_PATH": f"{folder}/ros:/usr"}
    with (folder / "aggregator.log").open("wb") as log:
        command = [AGGREGATOR_NODE]
        process = subprocess.Popen(
            command, env={**ros.master.environment, **here}, stdout=log, stderr=log, stdin=subprocess.DEVNULL
        )
    try:
        yield
    finally:
        process.kill()
        process.wait()


def test_the_real_aggregator_shows_each_component_with_level_hardware_and_explanation(tmp_path: Path) -> None:
    why = AGGREGATOR.install()
    if why and os.environ.get("CI"):
        pytest.fail(why)
    if why:
        pytest.skip(why)
    with observed_robot(tmp_path) as (ros, url, _), aggregator(ros, tmp_path):
        laser, watcher = ros.node("laser"), ros.node("watcher")
        laser.do("publish", topic="/map", type="std_msgs/String", rate=10)
        watcher.do("subscribe", topic="/diagnostics_agg", **DIAGNOSTICS)
        sections: dict[str, Any] = {
            "ros1": {"master": ros.master.uri},
            "topics": {"map": {"from": "ros1", "first_s": 60, **BUSY}},
            "observers": {"laser": {"kind": "node", "from": "ros1", "preset": "ros1"}},
        }

        def shown() -> dict[str, dict[str, Any]]:
            """Return the newest of what it shows, by name."""
            messages = heard(watcher, "/diagnostics_agg")
            return {status["name"]: status for status in messages[-1]["status"]} if messages else {}

        def levels() -> dict[str, int]:
            return {name: status["level"] for name, status in shown().items()}

        names = [f"/robomend/robomend: {name}" for name in ("lamp", "laser", "mapper")]
        with agent(config(tmp_path, url, {}, **sections)):
            well = dict.fromkeys(["/robomend", *names], OK)
            until(lambda: levels() == well, "all well, and nothing that it has no place for", 120)
            laser.do("hush", topic="/map")  # the map rests on the scan, which nobody observes
            either = {**well, "/robomend": WARN, names[1]: WARN, names[2]: WARN}
            until(lambda: levels() == either, "one of the two is broken", 60)
            status = shown()[names[2]]
            assert (status["message"], status["hardware_id"]) == ("perhaps broken", "mapper")
            assert {p["key"]: p["value"] for p in status["values"]}["in diagnoses"] == "1 of 2"
            laser.kill()
            until(
                lambda: levels() == {**well, "/robomend": ERROR, names[1]: ERROR}, "the laser is broken", 60
            )
            status = shown()[names[1]]
            assert (status["message"], status["hardware_id"]) == ("broken", "laser")
            values = {pair["key"]: pair["value"] for pair in status["values"]}
            assert values["in diagnoses"] == "1 of 1"
            assert "laser" in values["diagnosis 1"]
        until(lambda: levels().get("/robomend") == STALE, "nobody tells the diagnosis any more", 60)
