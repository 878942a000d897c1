"""A network that splits between the agent and nodes on another computer, and who is silent for as long."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually
from tests.other_computer import OtherComputer, other_computer
from tests.ros2 import Ros2Robot, robot

SOON_LOST = """
<profiles xmlns="http://www.eprosima.com">
  <participant profile_name="soon lost" is_default_profile="true"><rtps><builtin><discovery_config>
    <leaseDuration><sec>2</sec></leaseDuration>
    <leaseAnnouncement><sec>0</sec><nanosec>300000000</nanosec></leaseAnnouncement>
  </discovery_config></builtin></rtps></participant>
</profiles>
"""
"""Of the nodes' Fast DDS: whoever does not hear them takes them for lost after 2 s, not after 20."""


def soon_lost(folder: Path) -> dict[str, str]:
    """Return what nodes need in their environment to be so."""
    profile = folder / "soon_lost.xml"
    profile.write_text(SOON_LOST)
    return {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)}


@contextmanager
def robot_there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[OtherComputer, Ros2Robot]]:
    """A robot on another computer; our own part in DDS is on the cable between."""
    fast = {**soon_lost(folder), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    with other_computer() as computer, robot(folder, inside=computer.inside, more=fast) as ros:
        interface = f'<Interfaces><NetworkInterface address="{computer.here}"/></Interfaces>'
        ours = f'<CycloneDDS><Domain id="any"><General>{interface}</General></Domain></CycloneDDS>'
        monkeypatch.setenv("CYCLONEDDS_URI", ours)
        yield computer, ros


def test_of_nodes_behind_a_split_network_it_is_unknown_whether_they_run_until_it_is_whole_again(
    service: ServiceDouble, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is killed there does not run once its lease is over, or its computer says so."""
    with robot_there(tmp_path, monkeypatch) as (computer, ros):
        for name in ("laser", "mapper", "watcher", "camera"):
            ros.node(name)
        ros.nodes["laser"].do("publish", topic="/scan", type="std_msgs/String", rate=10)
        watcher = ros.nodes["watcher"]
        watcher.do("subscribe", topic="/observations", type="std_msgs/String")
        nodes = {"kind": "node", "from": "ros2", "preset": "ros2", "nodes": ["laser", "mapper", "camera"]}
        sections: dict[str, Any] = {
            "ros2": {"domain": ros.domain, "discovery": "subnet", "discovery_s": 1},
            "topics": {"scan": {"from": "ros2", "first_s": 60}},
            "observers": {"nodes": nodes},
        }
        log = tmp_path / "agent.log"
        complaint = f"ROS 2, the computer {computer.there}: "

        def over() -> bool:
            """Who hears nothing for 2 s as the machine is busy may complain; it ends by itself."""
            said = log.read_text()
            return said.count(f"{complaint}processes") == said.count(f"{complaint}well again")

        def signs(what: str, **wanted: bool | None) -> None:
            found = {
                ("ok(scan)" if name == "scan" else f"running({name})"): one for name, one in wanted.items()
            }
            eventually(lambda: found.items() <= service.signs().items(), what, 60)

        with agent(config(tmp_path, service.url, {}, **sections)):
            signs("all well", laser=True, mapper=True, camera=True, scan=True)
            eventually(lambda: watcher.heard, "the agent at the other side", 60)
            ros.nodes["camera"].kill()
            signs("one was killed", laser=True, camera=False)
            eventually(over, "of its computer, nothing", 60)
            computer.cut()
            signs("unknown", laser=None, mapper=None, scan=False)
            eventually(lambda: not over(), "a complaint", 60)
            ros.nodes["mapper"].kill()
            computer.mend()  # its computer is there again, and says that nobody has its port
            signs("all others well again", laser=True, mapper=False, scan=True)
            before = len(watcher.heard)
            eventually(lambda: len(watcher.heard) > before, "the agent is heard again", 60)
            eventually(over, "that it is over", 60)
    assert not any("not running(laser)" in batch["observations"] for batch in service.batches())
