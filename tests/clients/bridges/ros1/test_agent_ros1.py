"""A whole agent under a real robot: from its file to the service, which a double plays."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.ros1 import Robot

from robomend_client.agent.config import load
from robomend_client.yaml_reader import ConfigError


@pytest.fixture
def service() -> Iterator[ServiceDouble]:
    with service_double() as double:
        yield double


@contextmanager
def watching(
    folder: Path, service: ServiceDouble, ros: Robot, bridge: dict[str, Any] | None = None, **more: Any
) -> Iterator[subprocess.Popen[bytes]]:
    section = {"master": ros.master.uri, **(bridge or {})}
    with agent(config(folder, service.url, {}, ros1=section, **more)) as process:
        yield process


def test_a_killed_node_and_its_silent_topic_reach_the_service_with_their_evidence(
    ros: Robot, service: ServiceDouble, tmp_path: Path
) -> None:
    laser = ros.node("hokuyo_node")
    laser.do("publish", topic="/scan", type="std_msgs/String", rate=10)
    laser.do("publish", topic="/motor", type="std_msgs/Float64", value={"data": 80.0}, rate=10)
    sections: dict[str, Any] = {
        "topics": {"scan": {"from": "ros1", "first_s": 60}},
        "observers": {
            "hokuyo_node": {"kind": "node", "from": "ros1", "preset": "ros1"},
            "temperature": {"kind": "property", "from": "ros1", "source": "motor:data", "high": 60},
        },
    }
    with watching(tmp_path, service, ros, **sections):
        good = {"ok(scan)": True, "running(hokuyo_node)": True, "ok(temperature)": False}
        eventually(lambda: good.items() <= service.holds().items(), "all", 60)
        laser.kill()
        bad = {"ok(scan)": False, "running(hokuyo_node)": False}
        eventually(lambda: bad.items() <= service.holds().items(), "both", 60)
        first = next(b for b in service.batches() if "not running(hokuyo_node)" in b["observations"])
        place = first["observations"].index("not running(hokuyo_node)")
        assert first["since"][place] >= first["onset"][place]
        atoms = {entry["atom"] for entry in service.polls[-1]["observes"]}
        assert atoms == {"ok(scan)", "running(hokuyo_node)", "ok(temperature)"}


def test_without_its_master_nothing_is_said_of_nodes(
    ros: Robot, service: ServiceDouble, tmp_path: Path
) -> None:
    ros.master.stop()
    observers = {"n": {"kind": "node", "from": "ros1", "preset": "ros1"}}
    with watching(tmp_path, service, ros, observers=observers) as process:
        log = tmp_path / "agent.log"
        eventually(lambda: "the master: nobody listens" in log.read_text(), "a complaint", 60)
        eventually(lambda: service.polls, "an agent that works", 60)
        assert process.poll() is None
    assert service.holds() == {}


@pytest.mark.parametrize(
    ("section", "complaint"),
    [
        ({"master": "11311"}, "ros1.master: '11311' is no address; it should be like http://HOST:PORT/"),
        ({"name": "a b"}, "ros1.name: must be of letters, digits, _ and /, not 'a b'"),
        ({"pings": 1}, "ros1.pings: is no key here; did you mean ping_s?"),
        ({"ping_s": 0}, "ros1.ping_s: must be from 0.05 to 60, not 0"),
    ],
)
def test_a_bad_section_is_refused_with_file_line_and_key(
    section: dict[str, Any], complaint: str, tmp_path: Path
) -> None:
    file = config(tmp_path, "http://127.0.0.1:1", {}, ros1=section)
    done = subprocess.run(
        [sys.executable, "-m", "robomend_client.agent.main", "--check", str(file)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert f"{file}:1: {complaint}" in done.stderr
    assert json.loads(file.read_text())["ros1"] == section


def test_rosbags_is_not_imported_for_topics_that_nobody_looks_into(tmp_path: Path) -> None:
    file = config(tmp_path, "http://127.0.0.1:1", {}, topics={"scan": {"from": "ros1"}}, ros1={})
    code = (
        "import sys; from pathlib import Path; from robomend_client.agent.config import load; "
        f"load(Path({str(file)!r})); print({{'rosbags', 'numpy'}} & sys.modules.keys())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_manual_has_every_key_of_the_section_and_its_example_is_read(tmp_path: Path) -> None:
    manual = (Path(__file__).parents[4] / "docs" / "ros.md").read_text()
    file = tmp_path / "agent.yaml"
    example = manual.partition("\n    robot: ")[2].partition("\n\n")[0]
    file.write_text("robot: " + example.replace("\n    ", "\n") + "\n")
    config_read = load(file)
    assert {spec.origin for spec in config_read.observers} == {"ros1"}
    file.write_text(file.read_text().replace("  master:", "  nonsense: 1\n  master:"))
    with pytest.raises(ConfigError) as refused:
        load(file)
    known = re.findall(r"known are (.*)", str(refused.value))[0].split(", ")
    table = re.findall(r"^\| `(\w+)` \|", manual.partition("| key of `ros1`")[2].partition("\n\n")[0], re.M)
    assert sorted(known) == sorted(table)
