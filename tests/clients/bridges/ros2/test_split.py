"""A network that splits between the agent and nodes on another computer, and who is silent for as long."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.clients.bridges.ros2.listening import hearing
from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually, service_double
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


def test_of_the_nodes_behind_a_split_network_it_is_unknown_whether_they_run_until_it_is_whole_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with robot_there(tmp_path, monkeypatch) as (computer, ros), service_double() as service:
        laser, watcher = ros.node("laser"), ros.node("watcher")
        laser.do("publish", topic="/scan", type="std_msgs/String", rate=10)
        watcher.do("subscribe", topic="/observations", type="std_msgs/String")
        sections: dict[str, Any] = {
            "ros2": {"domain": ros.domain, "discovery": "subnet", "discovery_s": 1},
            "topics": {"scan": {"from": "ros2", "first_s": 60}},
            "observers": {"nodes": {"kind": "node", "from": "ros2", "preset": "ros2", "nodes": ["laser"]}},
        }
        log = tmp_path / "agent.log"
        complaint = f"ROS 2, the computer {computer.there}: "
        with agent(config(tmp_path, service.url, {}, **sections)):
            well = {"running(laser)": True, "ok(scan)": True}
            eventually(lambda: well.items() <= service.signs().items(), "all well", 60)
            eventually(lambda: watcher.heard, "the agent at the other side", 60)
            computer.cut()
            split = {"running(laser)": None, "ok(scan)": False}
            eventually(lambda: split.items() <= service.signs().items(), "unknown", 60)
            eventually(lambda: complaint in log.read_text(), "a complaint", 60)
            computer.mend()
            eventually(lambda: well.items() <= service.signs().items(), "all well again", 60)
            before = len(watcher.heard)
            eventually(lambda: len(watcher.heard) > before, "the agent is heard again", 60)
    assert not any("not running(laser)" in batch["observations"] for batch in service.batches())
    assert log.read_text().count(f"{complaint}processes there are not heard any more") == 1
    assert log.read_text().count(f"{complaint}well again") == 1


def test_a_node_that_is_killed_on_another_computer_does_not_run_once_its_lease_is_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test(computer: OtherComputer, ros: Ros2Robot) -> None:
        async with hearing(ros, "nodes", more="discovery_s: 1", discovery="subnet") as heard:
            await heard.runs({"laser": True, "mapper": True})
            ros.nodes["laser"].kill()
            await heard.runs({"laser": False, "mapper": True})
            assert heard.log == []
            computer.cut()
            await heard.runs({"laser": False, "mapper": None})
            ros.nodes["mapper"].kill()
            computer.mend()  # its computer is there again, and says that nobody has its port
            await heard.runs({"laser": False, "mapper": False})
            await heard.told(f"the computer {computer.there}: well again")

    with robot_there(tmp_path, monkeypatch) as (computer, ros):
        for node in ("laser", "mapper"):
            ros.node(node)
        asyncio.run(test(computer, ros))


def test_a_node_that_was_frozen_for_longer_than_its_lease_runs_again_when_it_goes_on(tmp_path: Path) -> None:
    """It has not lost us meanwhile, and does not tell again what it has."""

    async def test(ros: Ros2Robot) -> None:
        async with hearing(ros, "nodes", "scan", more="discovery_s: 1") as heard:
            await heard.more("scan")
            ros.nodes["laser"].signal(signal.SIGSTOP)
            await heard.until(lambda: not (heard.last("nodes") or {}).get("laser", False), "it is frozen")
            await asyncio.sleep(4)  # until its lease is over: nothing says when
            ros.nodes["laser"].signal(signal.SIGCONT)
            await heard.more("scan", 20)
            await heard.until(lambda: heard.last("nodes").get("laser"), "it runs")

    with robot(tmp_path, more=soon_lost(tmp_path)) as ros:
        ros.node("laser").do("publish", topic="/scan", type="std_msgs/String", rate=10)
        asyncio.run(test(ros))
