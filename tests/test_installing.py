"""What an installation may leave out, what the container's file says, and what a release is held to."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from tests import release
from tests.api.conftest import TEDUSAR
from tests.api.test_process import command, served

from robomend_client.rest import Client

ROOT = Path(__file__).resolve().parents[1]
DEPLOY = ROOT / "docs" / "deploy"

LEFT_OUT = (
    *("numpy", "scipy", "networkx", "unified_planning", "up_pyperplan", "pyperplan", "ConfigSpace"),
    # of extras
    *("psycopg", "polars", "rosbags", "lz4", "mcap", "python_multipart", "dask", "distributed", "mcp"),
    *("cyclonedds", "zenoh", "xxhash"),
)
BLOCKER = f"""
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {LEFT_OUT}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocked())
"""
SEEN = ("-o", "not on(jaguar)", "-o", "not ok(odom)")


# --- without Unified Planning and what comes with it, and without any extra


@pytest.fixture
def lean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every Python that is started from here finds none of LEFT_OUT, worker processes as well."""
    folder = tmp_path / "lean"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(BLOCKER)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    done = subprocess.run([sys.executable, "-c", "import numpy"], capture_output=True, timeout=60)
    assert b"No module named 'numpy'" in done.stderr


def said(*arguments: str) -> str:
    done = subprocess.run(command(*arguments), capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.usefixtures("lean")
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("diagnose", "examples/tedusar.yaml", *SEEN, "--format", "json"), '"bad":["jaguar"]'),
        (("plan", "examples/tedusar.yaml", *SEEN, "--format", "json"), '"planner": "dijkstra"'),
        (("model", "check", "examples/tedusar.yaml", "--isolability"), "can be detected"),
        (("doctor", "--data", "data"), "planner: solved by asp"),
    ],
)
def test_without_unified_planning_a_command_answers_and_the_plan_says_whose_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROBOMEND_PORT", "0")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    assert expected in said(*arguments)


@pytest.mark.usefixtures("lean")
def test_without_unified_planning_the_service_diagnoses_and_plans(tmp_path: Path) -> None:
    with served(tmp_path) as (_, url), Client(url) as client:
        client.put_model("tedusar", TEDUSAR)
        client.put_robot("r1", {"model": "tedusar", "policy": "observe"})
        revision = client.observe("r1", ["not on(jaguar)", "not ok(odom)"])["revision"]
        result = client.diagnosis("r1", wait_s=30, after=revision - 1)["result"]
        assert result is not None
        assert result["diagnoses"][0]["bad"] == ["jaguar"]
        plan = client.plan("r1", bad=["jaguar"])["plan"]
        assert (plan["planner"], plan["steps"][0]["name"]) == ("dijkstra", "power_up")


@pytest.mark.usefixtures("lean")
def test_without_unified_planning_each_program_begins() -> None:
    for program in ("robomend_client.agent.main", "robomend_board.main", "robomend.cli.main"):
        code = f"from {program} import main; main(['--help'])"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
        assert (done.returncode, "usage" in done.stdout.lower()) == (0, True), done.stderr


def test_the_lean_list_is_every_dependency_but_unified_planning() -> None:
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    own = ("robomend-client", "unified-planning", "up-pyperplan")
    client = tomllib.loads((ROOT / "clients" / "pyproject.toml").read_text())["project"]["dependencies"]
    lines = [line for line in (DEPLOY / "lean.txt").read_text().splitlines() if not line.startswith("#")]
    assert lines == [line for line in wanted if not line.startswith(own)]
    assert {re.split(r"\W", line)[0] for line in client} <= {re.split(r"\W", line)[0] for line in lines}


# --- the container


def steps() -> list[tuple[str, str]]:
    """Return the instructions of the Containerfile, each with its words."""
    text = re.sub(r"\\\n\s*", "", (DEPLOY / "Containerfile").read_text())
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [(line.partition(" ")[0], line.partition(" ")[2]) for line in lines]


def test_the_container_asks_a_service_for_its_health(tmp_path: Path) -> None:
    _, _, probe = dict(steps())["HEALTHCHECK"].partition("CMD ")
    with served(tmp_path) as (_, url):
        words = [one.replace("http://127.0.0.1:8600", url) for one in json.loads(probe)[1:]]
        assert subprocess.run([sys.executable, *words], timeout=60).returncode == 0


def test_the_container_names_what_the_package_has() -> None:
    """tests/test_release_files.py starts it."""
    given = dict(steps())
    [service, _] = release.PACKAGES
    assert given["EXPOSE"] == "8600"
    assert json.loads(given["ENTRYPOINT"]) == [f"{service.prefix}/bin/{service.commands[0]}"]
    assert given["VOLUME"] in json.loads(given["CMD"])
    unit = (DEPLOY / "robomend.service").read_text()
    assert f"User={given['USER']}" in unit
    assert json.loads(given["ENTRYPOINT"])[0] in unit


# --- the release
