"""The spare that takes a device's place, in the file that the nodes read."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from robomend_demo.cast import agent_config, nodes_config, tedusar, tedusar_with_spare
from robomend_demo.spare import switch

ADDRESSES = {"hokuyo": "127.0.0.1:1", "hokuyo_b": "127.0.0.1:2", "jaguar": "127.0.0.1:3"}


def nodes_file(folder: Path) -> Path:
    file = folder / "nodes.json"
    file.write_text(json.dumps(nodes_config(tedusar_with_spare().model, ADDRESSES)))
    return file


def test_a_driver_finds_the_spare_where_its_device_was(tmp_path: Path) -> None:
    file = nodes_file(tmp_path)
    before = json.loads(file.read_text())
    for _ in range(2):  # twice is as good as once: the action is declared to be idempotent
        switch(file, "hokuyo", "hokuyo_b")
        after = json.loads(file.read_text())
        assert after["devices"] == {**ADDRESSES, "hokuyo": ADDRESSES["hokuyo_b"]}
        assert after["nodes"] == before["nodes"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["nodes.json"]


def test_a_device_that_is_not_there_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    file = nodes_file(tmp_path)
    before = file.read_text()
    with pytest.raises(KeyError, match="sonar"):
        switch(file, "hokuyo", "sonar")
    assert file.read_text() == before


def test_the_agents_action_runs_it_for_the_spares_it_has_only(tmp_path: Path) -> None:
    file = nodes_file(tmp_path)
    robot = tedusar_with_spare()
    config = agent_config(robot.model, "r", "http://127.0.0.1:1", file, tmp_path, spares=robot.spares)
    action = config["actions"]["switch_to_spare"]
    assert action["parameters"] == {"device": ["hokuyo"], "spare": ["hokuyo_b"]}
    command = [one.format(device="hokuyo", spare="hokuyo_b") for one in action["command"]]
    assert subprocess.run(command, check=False).returncode == 0
    assert json.loads(file.read_text())["devices"]["hokuyo"] == ADDRESSES["hokuyo_b"]
    assert subprocess.run([*command[:3]], stderr=subprocess.DEVNULL, check=False).returncode == 2
    assert command[:1] == [sys.executable]


def test_the_robot_with_a_spare_is_the_papers_robot_but_for_that() -> None:
    own, paper = (yaml.safe_load(robot.source) for robot in (tedusar_with_spare(), tedusar()))
    assert own["hardware"].pop("hokuyo_b") == {"channel": 4}
    assert {**own, "name": paper["name"]} == paper
