"""`robomend init`: what it writes fits together, is read by our readers, and never replaces anything."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.cli.test_model_from_ros import recorded

from robomend.api.schemas.robots import RobotBody
from robomend.cli.commands import run
from robomend.cli.robot_file import read_robot
from robomend.cli.schema import schema_line, schema_name, schema_text
from robomend.model.checking import check
from robomend.model.loading import load_model
from robomend_client.agent.config import load

Capture = pytest.CaptureFixture[str]

WALKER = (
    *("init", "robot", "walker", "--device", "fan", "--device", "base=7"),
    *("--node", "camera=image", "--node", "detector=people", "--node", "base_node=odom"),
    *("--needs", "people=image", "--drives", "base_node=base", "--drives", "camera=fan"),
    *("--command", "camera=python3 camera.py --fast", "--rate", "image=5", "--board", "127.0.0.1:10001"),
)


def init(*arguments: str, folder: Path) -> int:
    return run([*arguments, "--folder", str(folder)])


# --- a robot


def test_a_robots_files_fit_together(tmp_path: Path, capsys: Capture) -> None:
    assert init(*WALKER, folder=tmp_path) == 0
    said = capsys.readouterr().err
    assert "robomend robot put walker robot.yaml --model walker.yaml" in said
    system = load_model(tmp_path / "walker.yaml")
    parts = system.parts
    assert parts is not None
    assert (parts.hardware["base"].channel, parts.hardware["fan"].blame) == (7, True)
    assert parts.nodes["detector"].publishes == {"people": ("image",)}
    assert check(system) == ()
    agent = load(tmp_path / "agent.yaml")
    assert (agent.robot, [name for name, _ in agent.topics]) == ("walker", ["image", "people", "odom"])
    assert {name: rate.rate_hz for name, rate in agent.topics} == {"image": 5, "people": 10, "odom": 10}
    (camera,) = agent.processes
    assert (camera.name, camera.command) == ("camera", ("python3", "camera.py", "--fast"))
    config = RobotBody.model_validate(read_robot(tmp_path / "robot.yaml"))
    assert config.model == parts.name == "walker"
    assert config.observed == ["ok(image)", "ok(people)", "ok(odom)", "running(camera)"]
    assert config.board is not None
    assert config.board.port == 10001


@pytest.mark.parametrize(
    ("file", "schema"), [("walker.yaml", "model"), ("agent.yaml", "agent"), ("robot.yaml", "robot")]
)
def test_a_robots_files_name_their_schemas_which_lie_beside_them(
    tmp_path: Path, file: str, schema: str
) -> None:
    assert init(*WALKER, folder=tmp_path) == 0
    assert (tmp_path / file).read_text().startswith(schema_line(schema))
    assert (tmp_path / schema_name(schema)).read_text() == schema_text(schema)


def test_what_is_there_is_not_overwritten_and_nothing_else_is_written(
    tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "robot.yaml").write_text("mine")
    assert init(*WALKER, folder=tmp_path) == 2
    assert "robot.yaml: there already" in capsys.readouterr().err
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("robot.yaml", "mine")]


@pytest.mark.parametrize("name", ["on", "front camera", "caméra", "-x"])
def test_any_name_of_a_node_survives_the_way_into_the_files(tmp_path: Path, name: str) -> None:
    arguments = ("init", "robot", "r", "--node", f"{name}=image {name}", "--command", f"{name}=true")
    assert init(*arguments, folder=tmp_path) == 0
    parts = load_model(tmp_path / "r.yaml").parts
    assert parts is not None
    assert {name: node.publishes for name, node in parts.nodes.items()} == {name: {f"image {name}": ()}}
    assert [process.name for process in load(tmp_path / "agent.yaml").processes] == [name]
    RobotBody.model_validate(read_robot(tmp_path / "robot.yaml"))


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--node", "camera=image", "--needs", "imgae=image"), "no topic is named 'imgae'; did you mean"),
        (("--node", "camera=image", "--device", "base=seven"), "'seven' is no channel"),
        (("--node", "camera=image", "--device", "a=3", "--device", "b=3"), "channel 3 is used twice"),
        (("--node", "camera=image", "--rate", "image=fast"), "'fast' is no rate"),
        (("--node", "camera=image", "--board", "here"), "'here' is no address of a power board"),
        (("--node", "camera=image", "--url", "nowhere"), "service.url: must start with http"),
        (("--node", "camera=image", "--ros2", "0"), "give --node and --device, or one of"),
        ((), "here is nobody to ask"),
    ],
)
def test_what_does_not_fit_is_said_and_nothing_is_written(
    tmp_path: Path, capsys: Capture, arguments: tuple[str, ...], complaint: str
) -> None:
    assert init("init", "robot", "r", *arguments, folder=tmp_path) == 2
    assert complaint in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_recording_gives_model_agent_and_configuration(tmp_path: Path) -> None:
    bag = recorded(tmp_path / "run.bag")
    assert init("init", "robot", "rover", "--bag", str(bag), folder=tmp_path) == 0
    parts = load_model(tmp_path / "rover.yaml").parts
    assert parts is not None
    assert parts.nodes["hokuyo_node"].publishes == {"scan": (), "late": ()}
    agent = load(tmp_path / "agent.yaml")
    assert {spec.name: spec.origin for spec in agent.observers} == {"scan": "ros1", "late": "ros1"}
    assert dict(agent.topics)["scan"].rate_hz == 20
    observed = RobotBody.model_validate(read_robot(tmp_path / "robot.yaml")).observed
    assert {*observed} == {"ok(scan)", "ok(late)"}


def asked(answers: list[str], folder: Path) -> str:
    """Return what `init robot` says to a person at a terminal who answers this."""
    person, terminal = pty.openpty()
    os.write(person, "".join(f"{answer}\n" for answer in answers).encode())
    command = [sys.executable, "-m", "robomend", "init", "robot"]
    done = subprocess.run(command, stdin=terminal, capture_output=True, cwd=folder, timeout=60, text=True)
    os.close(person)
    os.close(terminal)
    assert done.returncode == 0, done.stderr
    return done.stderr


def test_it_asks_a_person_at_a_terminal(tmp_path: Path) -> None:
    answers = ["walker", "fan", "camera detector", "image", "fan", "python3 camera.py"]
    answers += ["people", "", "", "5", "", "", "image", ""]
    told = asked(answers, tmp_path)
    assert "Nodes, the programs of the robot" in told
    parts = load_model(tmp_path / "walker.yaml").parts
    assert parts is not None
    assert (parts.nodes["camera"].drives, parts.nodes["detector"].publishes) == (
        ("fan",),
        {"people": ("image",)},
    )
    assert [process.name for process in load(tmp_path / "agent.yaml").processes] == ["camera"]


def test_a_wrong_answer_is_asked_again_at_once(tmp_path: Path) -> None:
    answers = ["walker", "base=seven", "base=7", "camera=image", "camera", "image", "bse", "base"]
    answers += ["python3 'camera.py", "python3 camera.py", "often", "5", "here", "", "8600", ""]
    told = asked(answers, tmp_path)
    for complaint in (
        "'seven' is no channel",
        "'camera=image' is no name",
        "no device is named 'bse'; did you mean 'base'?",
        "No closing quotation",
        "'often' is no rate",
        "'here' is no address of a power board",
        "'8600' is no address of a service",
    ):
        assert complaint in told
    parts = load_model(tmp_path / "walker.yaml").parts
    assert parts is not None
    assert parts.nodes["camera"].drives == ("base",)
    assert "http://127.0.0.1:8600" in (tmp_path / "agent.yaml").read_text()


# --- templates


@pytest.mark.parametrize(
    ("arguments", "files"),
    [
        (("observer", "motor_load"), {"motor_load.py", "test_motor_load.py"}),
        (
            ("action", "reset_camera", "camera"),
            {"reset_camera.pddl", "reset_camera.py", "test_reset_camera.py"},
        ),
    ],
)
def test_a_template_passes_its_own_test_and_fails_it_when_it_is_broken(
    tmp_path: Path, arguments: tuple[str, ...], files: set[str]
) -> None:
    tmp_path = tmp_path / ("deep" * 20)  # too long for a socket of the agent's bus
    assert init("init", *arguments, folder=tmp_path) == 0
    assert {path.name for path in tmp_path.iterdir()} == files
    name = arguments[1]
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"test_{name}.py"]
    alone = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    settings: dict[str, Any] = {"cwd": tmp_path, "capture_output": True, "text": True, "env": alone}
    done = subprocess.run(tests, check=False, timeout=60, **settings)
    assert done.returncode == 0, done.stdout
    ours = tmp_path / f"{name}.py"
    ours.write_text(ours.read_text().replace("<= self.most", "> self.most").replace("return 0", "return 1"))
    assert subprocess.run(tests, check=False, timeout=60, **settings).returncode == 1


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("observer", "Motor-Load"), "'Motor-Load' cannot be it"),
        (("observer", "class"), "'class' cannot be it"),
        (("action", "power_up", "camera"), "power_up is an action of the repair domain already"),
        (("action", "reset", "a b"), "'a b' is no name"),
    ],
)
def test_a_name_that_no_template_can_have_is_refused(
    tmp_path: Path, capsys: Capture, arguments: tuple[str, ...], complaint: str
) -> None:
    assert init("init", *arguments, folder=tmp_path) == 2
    assert complaint in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_device_of_an_action_is_looked_up_in_the_model(tmp_path: Path, capsys: Capture) -> None:
    assert init(*WALKER, folder=tmp_path) == 0
    model = str(tmp_path / "walker.yaml")
    assert init("init", "action", "reset_fan", "fam", "--model", model, folder=tmp_path / "a") == 2
    assert "no device 'fam'; did you mean 'fan'?" in capsys.readouterr().err
    assert init("init", "action", "reset_fan", "camera", "--model", model, folder=tmp_path / "a") == 2
    assert "no device 'camera' (it is a node); it has fan" in capsys.readouterr().err
    assert init("init", "action", "reset_fan", "fan", "--model", model, folder=tmp_path / "a") == 0
