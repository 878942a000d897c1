"""`robomend model from-ros`, from a real robot and from a recording."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from tests.blocks import BLOCKS
from tests.clients.bridges.any_robot import any_robot

from robomend.cli.commands import run
from robomend.model.loading import load_text


def shown(option: str, value: str) -> list[str]:
    """Return the command that a page shows with an option, as far as `>`, with a value of ours for it."""
    mine = [block for block in BLOCKS if block.test == f"tests/cli/{Path(__file__).name}"]
    [text] = [block.text for block in mine if option in block.text]
    program, *words = shlex.split(text.partition(">")[0])
    assert program == "robomend"
    words[words.index(option) + 1] = value
    return words


@pytest.mark.parametrize("origin", ["ros1", "ros2"])
def test_the_model_of_a_running_robot(
    origin: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with any_robot(origin, tmp_path) as robot:
        robot.node("laser").do("publish", topic="/scan", type="std_msgs/String")
        mapper = robot.node("mapper")
        mapper.do("subscribe", topic="/scan", type="std_msgs/String")
        mapper.do("publish", topic="/map", type="std_msgs/Float64")
        assert run(shown(f"--{origin}", str(next(iter(robot.section.values()))))) == 0
    told = capsys.readouterr().out
    assert "      map: [scan]    # std_msgs/Float64\n" in told
    assert "      scan: []    # std_msgs/String\n" in told
    assert sorted(load_text(told).cnf.components) == ["laser", "mapper"]


def recorded(file: Path) -> Path:
    """Record two topics of one node at 20 Hz, one of them late."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "std_msgs/msg/String"
    message = store.serialize_ros1(store.types[kind](data="x"), kind)
    with Writer(file) as bag:
        scan = bag.add_connection("/scan", kind, typestore=store, callerid="/hokuyo_node")
        for number in range(101):
            bag.write(scan, number * 50_000_000, message)
        late = bag.add_connection("/late", kind, typestore=store, callerid="/hokuyo_node")
        for number in range(21):
            bag.write(late, 4 * 10**9 + number * 50_000_000, message)
    return file


def test_the_model_of_a_recording_has_its_rates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["model", "from-ros", "--bag", str(recorded(tmp_path / "run.bag"))]) == 0
    told = capsys.readouterr().out
    assert "\n  hokuyo_node:    # listens to nothing" in told
    assert "\n  scan: {rate_hz: 20, tolerance_hz: 2}\n" in told
    assert "\n  late: {rate_hz: 20, tolerance_hz: 2}\n" in told
    load_text(told)


@pytest.mark.parametrize(
    ("arguments", "code", "why"),
    [
        ([], 2, "give one of --ros1, --ros2 and --bag"),
        (["--ros2", "233"], 2, "233 is not in the range 0<=x<=232"),
        (["--ros1", "nonsense"], 2, "'nonsense' is no address"),
        (["--ros1", "http://127.0.0.1:1/"], 3, "http://127.0.0.1:1/: nobody listens at 127.0.0.1:1"),
        (["--bag", "BAG"], 2, "cannot be read as a ROS 1 bag"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_said(
    arguments: list[str], code: int, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.bag"
    bad.write_bytes(b"#ROSBAG V2.0\nnothing more")
    assert run(["model", "from-ros", *(str(bad) if a == "BAG" else a for a in arguments)]) == code
    assert why in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<launch/>", "no node is started there: give the files that start nodes"),
        ('<launch><include file="$(find nav)/all.launch"/></launch>', "leaves open.*nav.*all.launch"),
        (
            '<launch><node name="rviz" pkg="rviz" type="rviz"/></launch>',
            "only tools or what had ended: /rviz",
        ),
    ],
)
def test_a_launch_file_without_a_node_of_the_robot_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    file = tmp_path / "robot.launch"
    file.write_text(text)
    assert run(["model", "from-ros", "--launch", str(file)]) == 2
    assert re.search(said, capsys.readouterr().err)


def test_a_launch_file_of_tools_and_others_packages_says_what_it_includes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    launch = tmp_path / "navigation.launch"
    launch.write_text(
        '<launch><include file="$(find others)/launch/bringup.launch"/>'
        '<node pkg="rviz" type="rviz" name="rviz"/><node pkg="rosbag" type="record" name="box"/></launch>'
    )
    assert run(["model", "from-ros", "--launch", str(launch)]) == 2
    said = capsys.readouterr().err
    assert "only tools or what had ended: /box, /rviz; " in said
    assert "what does `$(find others)/launch/bringup.launch` start, which it includes?" in said
