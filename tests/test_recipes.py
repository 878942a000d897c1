"""The recipes: what docs/ say is enough to add an engine, a planner, a route or a kind of component."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.api.test_process import command, served
from tests.distributions import install

from robomend.resources import resource

ROOT = Path(__file__).parents[1]
TEDUSAR = str(resource("examples", "tedusar.yaml"))
SEEN = ["not ok(scan)", "not on(jaguar)"]


def shown(page: str, heading: str) -> tuple[str, dict[str, dict[str, str]]]:
    """Return the module and the entry points that a section of the docs shows."""
    section = (ROOT / "docs" / page).read_text().partition(f"\n{heading}\n")[2]
    code, points = (
        re.search(rf"^```{language}\n(.*?)^```", section, re.MULTILINE | re.DOTALL)
        for language in ("python", "toml")
    )
    assert code
    assert points
    groups: dict[str, dict[str, str]] = tomllib.loads(points[1])["project"]["entry-points"]
    return code[1], {
        group: {name: path.removeprefix("my_package:") for name, path in named.items()}
        for group, named in groups.items()
    }


def third_party(folder: Path, monkeypatch: pytest.MonkeyPatch, page: str, heading: str) -> None:
    """Install what the docs show, for the processes that are started from now on."""
    code, points = shown(page, heading)
    monkeypatch.setenv("PYTHONPATH", str(install(folder, "my_package", code, points)))


def answered(*arguments: str) -> dict[str, Any]:
    """Return what a command of a fresh process answers."""
    observed = [word for sentence in SEEN for word in ("-o", sentence)]
    line = command(*arguments, *observed, "--format", "json")
    done = subprocess.run(line, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def bad(result: dict[str, Any]) -> list[list[str]]:
    return [diagnosis["bad"] for diagnosis in result["diagnoses"]]


def test_the_engine_of_the_docs_answers_by_command_and_over_http(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    third_party(tmp_path / "site", monkeypatch, "diagnosis.md", "## An engine of your own")
    told = answered("diagnose", TEDUSAR, "--engine", "mine")
    assert bad(told) == [["jaguar", "hokuyo"], ["jaguar", "hokuyo_node"]]
    for more in ([], ["--max-size", "1"], ["--assume-healthy", "hokuyo", "--minimal", "cardinality"]):
        mine = answered("diagnose", TEDUSAR, *more, "--engine", "mine")
        ours = answered("diagnose", TEDUSAR, *more)
        assert (bad(mine), mine["stopped_by"]) == (bad(ours), ours["stopped_by"])
    with served(tmp_path) as (_, url), httpx.Client(base_url=f"{url}/api/v1", timeout=60) as http:
        source = Path(TEDUSAR).read_text()
        asked = {"source": source, "observations": SEEN, "options": {"engine": "mine"}}
        assert bad(http.post("/diagnoses", json=asked).json()) == bad(told)
        http.put("/models/m", json={"source": source})
        robot = {"model": "m", "diagnosis": {"engine": "mine"}}
        assert http.put("/robots/r1", json=robot).status_code == 201
        http.post("/robots/r1/observations", json={"observations": SEEN})
        found = http.get("/robots/r1/diagnosis", params={"wait_s": 30, "after": 0}).json()
        assert bad(found["result"]) == bad(told)
        refused = http.put("/robots/r2", json={"model": "m", "diagnosis": {"engine": "mime"}})
        assert (refused.status_code, refused.json()["code"]) == (422, "option-refused")
        assert "did you mean 'mine'" in refused.json()["detail"]


def test_the_planner_of_the_docs_plans_by_command_and_over_http(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    third_party(tmp_path / "site", monkeypatch, "planning.md", "### A planner of your own")
    told = answered("plan", TEDUSAR, "--planner", "mine", "--bad", "jaguar")
    steps = ["power_up(jaguar)", "stop_node(jaguar_node)", "start_node(jaguar_node)"]
    assert [step["text"] for step in told["plan"]["steps"]] == steps
    assert told["plan"]["planner"] == "mine"
    with served(tmp_path) as (_, url), httpx.Client(base_url=f"{url}/api/v1", timeout=60) as http:
        asked = {"source": Path(TEDUSAR).read_text(), "observations": SEEN, "bad": ["jaguar"]}
        plan = http.post("/plans", json={**asked, "planner": "mine"}).json()["plan"]
        assert [step["text"] for step in plan["steps"]] == steps
        assert plan["planner"] == "mine"
        refused = http.post("/plans", json={**asked, "planner": "mime"})
        assert "did you mean 'mine'" in refused.json()["detail"]


KIND_MODEL = """
robomend: 1
name: cart
batteries:
  main: {feeds: [panel], prior: 0.2, protected: false}
nodes:
  driver: {publishes: [odom]}
properties: [panel]
"""


def with_kind(root: Path) -> None:
    """Do in a copy of the tree what docs/models.md says."""
    section = (
        (ROOT / "docs" / "models.md").read_text().partition("\n### A kind of component of your own\n")[2]
    )
    python, lisp = (re.search(rf"```{name}\n(.*?)```", section, re.DOTALL) for name in ("python", "lisp"))
    assert python
    assert lisp
    kind, predicates, action = lisp[1].split("\n\n", 2)
    components = root / "service/robomend/model/components.py"
    head, marker, tail = components.read_text().partition(
        "\n\n@dataclass(frozen=True, slots=True)\nclass Topic:"
    )
    components.write_text(f"{head}\n\n{python[1]}{marker}{tail}")
    pddl = root / "pddl/repair.pddl"
    text = pddl.read_text().replace("  (:predicates", f"  (:predicates\n    {predicates}", 1)
    text, types = re.subn(r"(\(:types component[^)]* - component)\)", rf"\1 {kind})", text, count=1)
    assert types == 1
    pddl.write_text(f"{text.rstrip().removesuffix(')')}\n{action})\n")


def test_the_kind_of_component_of_the_docs_is_modelled_diagnosed_and_repaired(tmp_path: Path) -> None:
    for folder in ("service", "clients", "pddl", "encodings"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("*.pyc.*"))
    with_kind(tmp_path)
    cart = tmp_path / "cart.yaml"
    cart.write_text(KIND_MODEL)
    path = os.pathsep.join(str(tmp_path / source) for source in ("service", "clients"))

    def asked(*words: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": path}
        line = command(*words)
        return subprocess.run(line, capture_output=True, text=True, timeout=60, check=False, env=environment)

    seen = ["-o", "not charged(main)", "-o", "not ok(panel)", "-o", "ok(odom)", "--format", "json"]
    found = json.loads(asked("diagnose", str(cart), *seen).stdout)
    assert bad(found) == [["main"]]
    plan = json.loads(asked("plan", str(cart), *seen).stdout)
    assert [step["text"] for step in plan["plan"]["steps"]] == ["dock(main)"]
    cart.write_text(KIND_MODEL.replace("feeds", "fed"))
    assert "battery main has no key `fed`; did you mean `feeds`?" in asked("model", "check", str(cart)).stderr
    cart.write_text(KIND_MODEL.replace("driver:", "main:"))
    told = asked("model", "check", str(cart)).stderr
    assert "`main` is a node already; a battery needs a name of its own" in told
    cart.write_text(KIND_MODEL.replace("properties: [panel]", "properties: [pannel]"))
    told = asked("model", "check", str(cart)).stderr
    assert "cart.yaml:5: battery main: " in told
    assert "no topic or property is named panel; did you mean pannel?" in told
