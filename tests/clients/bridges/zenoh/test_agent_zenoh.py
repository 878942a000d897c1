"""The section `zenoh:` of the agent's file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually, service_double
from tests.zenoh_robot import ZenohRobot

from robomend_client.agent.config import load
from robomend_client.agent.feeds import NEEDS
from robomend_client.agent.main import main
from robomend_client.yaml_reader import ConfigError


def test_a_killed_node_and_its_silent_topic_reach_the_service(
    zenoh_robot: ZenohRobot, tmp_path: Path
) -> None:
    laser = zenoh_robot.node("hokuyo_node")
    laser.do("publish", topic="/scan", type="std_msgs/String", rate=10)
    laser.do("publish", topic="/motor", type="std_msgs/Float64", value={"data": 80.0}, rate=10)
    sections: dict[str, Any] = {
        "zenoh": {"connect": [zenoh_robot.endpoint], "discovery_s": 0.5},
        "topics": {"scan": {"from": "zenoh", "first_s": 60}},
        "observers": {
            "hokuyo_node": {"kind": "node", "from": "zenoh", "preset": "ros2"},
            "temperature": {"kind": "property", "from": "zenoh", "source": "motor:data", "high": 60},
        },
    }
    with service_double() as service, agent(config(tmp_path, service.url, {}, **sections)):
        good = {"ok(scan)": True, "running(hokuyo_node)": True, "ok(temperature)": False}
        eventually(lambda: good.items() <= service.holds().items(), "all", 60)
        laser.kill()
        bad = {"ok(scan)": False, "running(hokuyo_node)": False}
        eventually(lambda: bad.items() <= service.holds().items(), "both", 60)


@pytest.mark.parametrize(
    ("section", "complaint"),
    [
        ({"domain": 233}, "zenoh.domain: must be from 0 to 232, not 233"),
        ({"connect": "tcp/here:1"}, "zenoh.connect: must be a list"),
        ({"publish": ["nothing"]}, "zenoh.publish: must be of observations, diagnosis, diagnostics, not"),
        ({"conect": []}, "zenoh.conect: is no key here; did you mean connect?"),
    ],
)  # fmt: skip
def test_a_bad_section_is_refused_with_file_line_and_key(
    section: dict[str, Any], complaint: str, tmp_path: Path
) -> None:
    file = config(tmp_path, "http://127.0.0.1:1", {}, zenoh=section)
    with pytest.raises(ConfigError, match=re.escape(f"{file}:1: {complaint}")):
        load(file)


def test_without_the_extra_the_agent_ends_with_3_and_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(NEEDS, "zenoh", ("rosbags", "no_module_that_anybody_has"))
    assert main([str(config(tmp_path, "http://127.0.0.1:1", {}, zenoh={}))]) == 3
    assert "pip install 'robomend-client[zenoh]'" in capsys.readouterr().err


def test_an_address_that_is_none_is_told_and_the_agent_goes_on(tmp_path: Path) -> None:
    with agent(config(tmp_path, "http://127.0.0.1:1", {}, zenoh={"connect": ["nonsense"]})) as process:
        log = tmp_path / "agent.log"
        eventually(lambda: "zenoh, the session: cannot be opened" in log.read_text(), "a complaint", 60)
        assert process.poll() is None
    assert log.read_text().count("cannot be opened") == 1


def test_the_manual_has_every_key_of_the_section_and_its_example_is_read(tmp_path: Path) -> None:
    manual = (Path(__file__).parents[4] / "docs" / "zenoh.md").read_text()
    file = tmp_path / "agent.yaml"
    example = manual.partition("\n    robot: ")[2].partition("\n\n")[0]
    file.write_text("robot: " + example.replace("\n    ", "\n") + "\n")
    assert {spec.origin for spec in load(file).observers} == {"zenoh"}
    file.write_text(file.read_text().replace("  domain:", "  nonsense: 1\n  domain:"))
    with pytest.raises(ConfigError) as refused:
        load(file)
    known = re.findall(r"known are (.*)", str(refused.value))[0].split(", ")
    table = re.findall(r"^\| `(\w+)` \|", manual.partition("| key of `zenoh`")[2].partition("\n\n")[0], re.M)
    assert sorted(known) == sorted(table)
