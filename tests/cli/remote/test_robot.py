"""`robomend robot`: a configuration goes there and comes back."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from tests.api.conftest import TEDUSAR
from tests.cli.remote.conftest import Say, Shared, answer, narrow

from robomend.cli.robot_file import read_robot


def test_a_robot_is_configured_and_its_configuration_comes_back_as_a_file(
    say: Say, shared: Shared, robot: str, configuration: Path, tmp_path: Path
) -> None:
    code, out, _ = say("robot", "put", robot, str(configuration))
    assert code == 0
    assert narrow(out)
    assert out.startswith(f"robot {robot}: created\n")
    assert "note: nobody reports ok(scan)" in out
    _, text, _ = say("robot", "get", robot)
    file = tmp_path / "back.yaml"
    file.write_text(text)
    config = answer(say("robot", "get", robot, "--format", "json"))
    assert read_robot(file) == config
    assert (config["hold_s"], config["expected"]) == (1.5, {"stopped": ["rviz"]})
    shared.client.observe(robot, ["ok(scan)"])
    file.write_text(text.replace('policy: "approve"', "policy: observe"))
    assert answer(say("robot", "put", robot, str(file), "--format", "json"))["config"]["policy"] == "observe"
    assert shared.client.observations(robot)["revision"] == 1  # what was observed stays


def test_the_model_comes_with_the_robot_where_that_is_asked_for(
    say: Say, shared: Shared, robot: str, tmp_path: Path
) -> None:
    (tmp_path / "m.yaml").write_text(TEDUSAR)
    file = tmp_path / "robot.yaml"
    file.write_text(f"model: tedusar-{robot}\n")
    code, _, err = say("robot", "put", robot, str(file))
    assert code == 2
    assert f"no model 'tedusar-{robot}'; did you mean 'tedusar'?; --model FILE stores one" in err
    line = ("robot", "put", robot, str(file), "--model", str(tmp_path / "m.yaml"))
    _, out, err = say(*line)
    assert (out.splitlines()[0], err) == (f"robot {robot}: created", f"model tedusar-{robot}: created\n")
    _, out, err = say(*line)
    assert (out.splitlines()[0], err) == (f"robot {robot}: as it was", f"model tedusar-{robot}: as it was\n")
    (tmp_path / "m.yaml").write_text(f"{TEDUSAR}\n# seen again\n")
    file.write_text(f"{file.read_text()}policy: observe\n")
    _, out, err = say(*line)
    assert out.splitlines()[0] == f"robot {robot}: changed"
    assert err == f"model tedusar-{robot}: a new version\n"
    assert shared.client.model(f"tedusar-{robot}").value["number"] == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("model: [\n", "robot.yaml:2: "),
        ("- model\n", "robot.yaml:1: a robot's configuration is a mapping"),
        ("policy: auto\n", "`model` names the model that the robot follows"),
        (
            "model: tedusar\npolcy: auto\n",
            "robot.yaml:2: `polcy`: Extra inputs are not permitted; did you mean 'policy'?",
        ),
        ("model: tedusar\n\nhold_s: soon\n", "robot.yaml:3: `hold_s`: Input should be a valid number"),
        (
            "model: tedusar\nboard:\n  host: b\n  port: many\n",
            "robot.yaml:4: `board.port`: Input should be a valid integer",
        ),
        ("robomend: 1\nnodes: {}\n", "robot.yaml:1: this is a model (it has nodes, robomend)"),
    ],
)
def test_a_file_at_fault_is_refused_with_its_place(
    text: str, said: str, say: Say, robot: str, tmp_path: Path
) -> None:
    (tmp_path / "robot.yaml").write_text(text)
    code, out, err = say("robot", "put", robot, str(tmp_path / "robot.yaml"))
    assert (code, out) == (2, "")
    assert said in err


def test_a_model_at_fault_is_refused_with_its_file_and_line(say: Say, robot: str, tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(f"model: faulty-{robot}\n")
    (tmp_path / "m.yaml").write_text("robomend: 1\nname: m\nnodes:\n  a: {publises: [b]}\n")
    line = ("robot", "put", robot, str(tmp_path / "robot.yaml"), "--model", str(tmp_path / "m.yaml"))
    code, _, err = say(*line)
    assert code == 2
    assert f"{tmp_path / 'm.yaml'}:4: node a has no key `publises`; did you mean `publishes`?" in err


def test_robots_are_listed_and_deleted(
    say: Say, shared: Shared, robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert f"{robot}  " not in say("robot", "list")[1]
    shared.robot(robot)
    code, out, _ = say("robot", "list")
    assert code == 0
    assert narrow(out)
    assert f"{robot}  " in out
    listed = answer(say("robot", "list", "--format", "json"))["items"]
    assert [one["model"] for one in listed if one["id"] == robot] == ["tedusar"]
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    code, _, err = say("robot", "delete", robot)
    assert code != 0
    assert f"delete robot {robot}" in err
    assert say("robot", "delete", robot, "--yes") == (0, f"robot {robot}: deleted\n", "")
    code, _, err = say("robot", "delete", robot, "--yes")
    assert code == 2
    assert f"no robot is named '{robot}'" in err


def test_what_is_in_quarantine_is_listed_and_only_that_is_released(
    say: Say, shared: Shared, robot: str
) -> None:
    shared.robot(robot)
    assert say("robot", "release", robot) == (0, f"nothing of {robot} is in quarantine\n", "")
    code, _, err = say("robot", "release", robot, "hokuyo")
    assert code == 2
    assert f"'hokuyo' of {robot} is not in quarantine; there are: none" in err
