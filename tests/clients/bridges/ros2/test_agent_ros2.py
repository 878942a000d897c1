"""A whole agent under a real robot: from its file to the service, which a double plays."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually, service_double
from tests.ros2 import Ros2Robot

from robomend_client.agent.config import load
from robomend_client.agent.feeds import NEEDS, MissingExtra
from robomend_client.agent.main import main
from robomend_client.yaml_reader import ConfigError


def test_a_killed_node_and_its_silent_topic_reach_the_service_with_their_evidence(
    ros: Ros2Robot, tmp_path: Path
) -> None:
    laser = ros.node("hokuyo_node")
    laser.do("publish", topic="/scan", type="std_msgs/String", rate=10, reliable=False)
    laser.do("publish", topic="/motor", type="std_msgs/Float64", value={"data": 80.0}, rate=10)
    sections: dict[str, Any] = {
        "ros2": {"domain": ros.domain, "discovery": "localhost"},
        "topics": {"scan": {"from": "ros2", "first_s": 60}},
        "observers": {
            "hokuyo_node": {"kind": "node", "from": "ros2", "preset": "ros2"},
            "temperature": {"kind": "property", "from": "ros2", "source": "motor:data", "high": 60},
        },
    }
    with service_double() as service, agent(config(tmp_path, service.url, {}, **sections)):
        good = {"ok(scan)": True, "running(hokuyo_node)": True, "ok(temperature)": False}
        eventually(lambda: good.items() <= service.holds().items(), "all", 60)
        laser.kill()
        bad = {"ok(scan)": False, "running(hokuyo_node)": False}
        eventually(lambda: bad.items() <= service.holds().items(), "both", 60)
        first = next(b for b in service.batches() if "not running(hokuyo_node)" in b["observations"])
        place = first["observations"].index("not running(hokuyo_node)")
        assert first["since"][place] >= first["onset"][place]
        assert not any("not running(hokuyo_node)" in b["observations"] for b in service.batches()[:1])


@pytest.mark.parametrize(
    ("section", "complaint"),
    [
        ({"domain": 233}, "ros2.domain: must be from 0 to 232, not 233"),
        ({"domain": 1.5}, "ros2.domain: must be a whole number, not 1.5"),
        ({"discovery": "world"}, "ros2.discovery: must be"),
        ({"name": "a b"}, "ros2.name: must be of letters, digits, _ and /, not 'a b'"),
        ({"publish": ["nothing"]}, "ros2.publish: must be of observations, diagnosis, diagnostics, not"),
        ({"domains": 1}, "ros2.domains: is no key here; did you mean domain?"),
    ],
)  # fmt: skip
def test_a_bad_section_is_refused_with_file_line_and_key(
    section: dict[str, Any], complaint: str, tmp_path: Path
) -> None:
    file = config(tmp_path, "http://127.0.0.1:1", {}, ros2=section)
    with pytest.raises(ConfigError, match=re.escape(f"{file}:1: {complaint}")):
        load(file)


def test_without_the_extra_the_agent_ends_with_3_and_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(NEEDS, "ros2", ("rosbags", "no_module_that_anybody_has"))
    file = config(tmp_path, "http://127.0.0.1:1", {}, ros2={})
    with pytest.raises(MissingExtra):
        load(file)
    assert main([str(file)]) == 3
    assert "ros2 needs what is installed with: pip install 'robomend-client[ros2]'" in capsys.readouterr().err


def test_what_is_not_wanted_is_not_imported(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from robomend_client.agent.config import load; "
        "load(Path(sys.argv[1])); print(sorted({'rosbags', 'numpy', 'cyclonedds'} & sys.modules.keys()))"
    )

    def imported(**sections: Any) -> str:
        file = config(tmp_path, "http://127.0.0.1:1", {}, **sections)
        done = subprocess.run(
            [sys.executable, "-c", code, str(file)], capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    assert imported() == "[]"
    assert imported(topics={"scan": {"from": "ros2"}}, ros2={}) == "['cyclonedds']"


def test_a_domain_that_cannot_be_entered_is_told_and_tried_again(tmp_path: Path) -> None:
    bad = "<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface name='no_such0'/></Interfaces>"
    bad += "</General></Domain></CycloneDDS>"
    file = config(tmp_path, "http://127.0.0.1:1", {}, ros2={"discovery": "subnet"})
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("CYCLONEDDS_URI", bad)
        with agent(file) as process:
            log = tmp_path / "agent.log"
            eventually(lambda: "ROS 2, DDS: domain 0 cannot be entered" in log.read_text(), "a complaint", 60)
            assert process.poll() is None
    assert log.read_text().count("cannot be entered") == 1


def test_the_manual_has_every_key_of_the_section_and_its_example_is_read(tmp_path: Path) -> None:
    manual = (Path(__file__).parents[4] / "docs" / "ros2.md").read_text()
    file = tmp_path / "agent.yaml"
    example = manual.partition("\n    robot: ")[2].partition("\n\n")[0]
    file.write_text("robot: " + example.replace("\n    ", "\n") + "\n")
    config_read = load(file)
    assert {spec.origin for spec in config_read.observers} == {"ros2"}
    file.write_text(file.read_text().replace("  domain:", "  nonsense: 1\n  domain:"))
    with pytest.raises(ConfigError) as refused:
        load(file)
    known = re.findall(r"known are (.*)", str(refused.value))[0].split(", ")
    table = re.findall(r"^\| `(\w+)` \|", manual.partition("| key of `ros2`")[2].partition("\n\n")[0], re.M)
    assert sorted(known) == sorted(table)
