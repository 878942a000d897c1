"""A whole agent under a real robot: from its file to the service, which a double plays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually


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
