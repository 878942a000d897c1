"""`robomend drill --plan` against a running service."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.api.conftest import TEDUSAR, running
from tests.api.test_process import served

from robomend.cli.commands import run
from robomend.cli.drill_plan import only_believed
from robomend.model.loading import load_text
from robomend.settings import Settings
from robomend_client.rest import Client

Capture = pytest.CaptureFixture[str]
SEEN = ["on(hokuyo)", "ok(scan)", "running(hokuyo_node)"]


def planned(url: str, capsys: Capture, robot: str = "r1") -> tuple[int, dict[str, Any]]:
    """Return the exit code and the plan; before it may be a service's log."""
    code = run(["drill", robot, "--plan", "--url", url, "--format", "json"])
    answer: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return code, answer


def test_a_plan_says_what_would_be_done_and_what_stands_in_the_way(tmp_path: Path, capsys: Capture) -> None:
    with served(tmp_path) as (_, url), Client(url) as client:
        client.put_model("tedusar", TEDUSAR)
        client.put_robot("r1", {"model": "tedusar", "observed": SEEN, "protected": ["jaguar_node"]})
        code, plan = planned(url, capsys)
        assert code == 1
        assert any("unknown" in obstacle for obstacle in plan["obstacles"])
        client.observe("r1", SEEN)
        code, plan = planned(url, capsys)
        assert (code, plan["obstacles"], plan["complete"]) == (0, [], True)
        faults = {(fault["kind"], fault["component"]): fault for fault in plan["faults"]}
        killed = faults["node-killed", "hokuyo_node"]
        assert killed["shows"] == ["not ok(scan)", "not running(hokuyo_node)"]
        assert (killed["promise"], killed["by"]) == ("told", "agent")
        assert "protected" in faults["node-killed", "jaguar_node"]["refused"]
        assert "no `board`" in faults["device-off", "hokuyo"]["refused"]

        polled: dict[str, Any] = {
            "agent": "onboard",
            "wait_s": 0,
            "can": ["plant_fault:hokuyo_node", "plant_fault:scan"],
            "observes": [{"atom": "ok(map)", "detection_s": 0.5, "settling_s": 0.5}],
        }
        assert httpx.post(f"{url}/api/v1/robots/r1/actions/next", json=polled, timeout=60).status_code == 204
        [agent] = client.robot("r1").value["agents"]
        assert (agent["agent"], agent["observes"]) == ("onboard", ["ok(map)"])
        _, plan = planned(url, capsys)
        named = {(f["kind"], f["component"], f["topic"]): f for f in plan["faults"]}
        killed = named["node-killed", "hokuyo_node", None]
        assert "not ok(map)" in killed["shows"]  # nobody else says that it is observed
        assert (killed["refused"], killed["observers"]) == (None, {"ok(map)": "agent onboard"})
        assert named["topic-dropped", "hokuyo_node", "scan"]["refused"] is None
        nobodys = (("node-frozen", "hector_mapping", None), ("topic-delayed", "hector_mapping", "map"))
        assert all("nobody could plant it" in named[fault]["refused"] for fault in nobodys)

        client.stop("lunch")
        client.observe("r1", ["not ok(scan)"])
        client.diagnosis("r1")
        code, plan = planned(url, capsys)
        assert code == 1
        for words in ("lunch", "unhealthy"):
            assert any(words in obstacle for obstacle in plan["obstacles"])

        assert run(["drill", "r1", "--plan", "--url", url]) == 1
        out = capsys.readouterr().out
        assert "told: the only diagnosis" in out
        assert re.search(r"^never: device-off:hokuyo.*: ", out, re.MULTILINE)
        assert "\nonly believed, as no drill here has shown it:\n" in out
        assert (
            "  map rests on scan: device-unplugged:hokuyo or node-killed:hokuyo_node would show it\n" in out
        )
        for fault in plan["faults"]:  # by the name that --fault takes
            target = fault["topic"] or fault["component"]
            name = fault["kind"] + (f":{target}" if target else "")
            assert fault["refused"] is not None or f"{name}: {fault['act']}" in out


def test_robots_that_are_never_acted_on_or_whose_windows_are_closed_are_refused(
    tmp_path: Path, capsys: Capture
) -> None:
    with running(Settings(port=0, data=tmp_path)) as service:
        never = [{"weekdays": [0], "start": "00:00", "end": "00:00"}]
        service.with_robot("r1", policy="observe", windows=never)
        _, plan = planned(service.url, capsys)
        said = " ".join(plan["obstacles"])
        # The repairs that this service tells of are a double's: one is open.
        for words in (
            "`observe`",
            "nothing is said to be observed",
            "no maintenance window",
            "repair r-1 is",
        ):
            assert words in said


def test_what_cannot_be_planned_is_refused(tmp_path: Path, capsys: Capture) -> None:
    assert run(["drill", "r1"]) == 2
    assert "--plan" in capsys.readouterr().err
    assert run(["drill", "r1", "--plan", "--url", "http://127.0.0.1:1"]) == 3
    with running(Settings(port=0, data=tmp_path)) as service:
        service.api("PUT", "/models/c17", json={"source": "INPUT(a)\nOUTPUT(b)\nb = NOT(a)\n"})
        service.api("PUT", "/robots/r2", json={"model": "c17"})
        assert run(["drill", "r2", "--plan", "--url", service.url]) == 2
        assert "no component model" in capsys.readouterr().err


def test_what_a_drill_has_seen_fail_together_is_not_only_believed() -> None:
    parts = load_text(TEDUSAR, name="tedusar").parts
    assert parts is not None
    seen = {"showed": {"not ok(scan)": 0.4, "not ok(map)": 1.2}}
    before = only_believed(parts, [], [{"seen": None}, {"seen": {"showed": {"not ok(map)": 1.0}}}])
    after = only_believed(parts, [], [{"seen": seen}])
    [shown] = [one for one in before if one not in after]
    assert shown == {"topic": "map", "rests_on": "scan", "publisher": "hokuyo_node", "shown_by": []}
