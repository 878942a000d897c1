"""Each part of a robot's side is frozen (SIGSTOP) for longer than what it says holds, and goes on."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from subprocess import Popen
from typing import Any

import httpx
import pytest
from tests.api.test_process import served, workers_of
from tests.clients.running_agent import SLEEPER, pid_file
from tests.clients.talker import watching
from tests.freezing import frozen, starved
from tests.robomend_board.processes import Running
from tests.robomend_board.processes import running as emulator
from tests.waiting import until

from robomend.cli.commands import run
from robomend_client.rest.sync import Client

MODEL = {
    "robomend": 1,
    "name": "bot",
    "hardware": {"lamp": {"channel": 3}},
    "nodes": {"laser": {"publishes": {"scan": []}}},
    "properties": {"lamp_draws": {}, "motor": {}},
}
AGENTS = {"ok(motor)", "running(laser)"}
BOARDS = {"on(lamp)", "ok(lamp_draws)"}


@dataclass(frozen=True)
class BoardRobot:
    """The robot is called tedusar, as in the agents' configurations of tests."""

    board: Running
    service: Popen[str]
    url: str
    client: Client


@contextmanager
def robot_with_board(folder: Path, model: Mapping[str, Any]) -> Iterator[BoardRobot]:
    """Serve it from a folder; nothing acts on it."""
    with emulator("--on", "3") as board, served(folder) as (service, url), Client(url) as client:
        client.put_model("bot", json.dumps(model))
        at = {"host": "127.0.0.1", "port": board.port, "protected": [], "rate_hz": 10}
        client.put_robot("tedusar", {"model": "bot", "policy": "observe", "board": at})
        yield BoardRobot(board, service, url, client)


def test_whoever_is_frozen_the_others_go_on_and_all_is_well_once_it_goes_on(tmp_path: Path) -> None:
    tells = f"import os; open({str(tmp_path / 'node')!r}, 'w').write(str(os.getpid())); {SLEEPER[2]}"
    sections: dict[str, Any] = {
        "observers": {
            "motor": {"kind": "property", "source": "motor:temperature", "high": 60},
            "lamp_draws": {"kind": "property", "from": "board", "source": "board:current(lamp)", "low": 0.01},
        },
        "board": {"rate_hz": 10},
        "processes": {"laser": {"command": [*SLEEPER[:2], tells], "start": True}},
    }
    with robot_with_board(tmp_path, MODEL) as robot:
        client, service = robot.client, robot.service
        log = tmp_path / "agent.log"

        def held() -> set[str]:
            found = client.observations("tedusar")["observations"]
            return {one["literal"] for one in found if one["fresh"]}

        with watching(tmp_path, robot.url, **sections) as (agent, talker):
            talker.say("motor", data={"temperature": 40})
            until(lambda: held() == AGENTS | BOARDS, "all well", 60)
            with frozen(agent.pid):
                until(lambda: held() == {"on(lamp)"}, "what the agent said is unknown", 60)
            until(lambda: held() == AGENTS | BOARDS, "all well again", 60)
            with frozen(robot.board.process.pid):
                until(lambda: held() == AGENTS, "what the board said is unknown", 60)
            until(lambda: held() == AGENTS | BOARDS, "all well again", 60)
            with frozen(service.pid, *workers_of(service.pid)):
                until(lambda: "they wait on the disk" in log.read_text(), "nobody takes what it says", 60)
                os.kill(pid_file(tmp_path, "node"), signal.SIGKILL)
            gone = {"ok(motor)", "not running(laser)"} | BOARDS
            until(lambda: held() == gone, "what happened meanwhile", 60)
            assert log.read_text().count("they wait on the disk") == 1
            said = str(client.history("tedusar", limit=1000))
            assert "not running(laser)" in said
            assert not any(wrong in said for wrong in ("not ok", "not on"))


def test_a_computer_that_is_starved_is_named_wherever_a_person_looks_and_since_when(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motor = {"motor": {"kind": "property", "source": "motor:temperature", "high": 60}}
    with served(tmp_path) as (_, url), Client(url) as client:
        client.put_model("bot", json.dumps(MODEL))
        client.put_robot("tedusar", {"model": "bot", "observed": ["ok(motor)", "ok(scan)"]})

        def since() -> str:
            """Return since when it is starved, or nothing."""
            agents = client.robot("tedusar").value["agents"]
            return str(agents[0]["starved"] or "") if agents else ""

        with watching(tmp_path, url, observers=motor) as (agent, talker):
            talker.say("motor", data={"temperature": 40})
            until(lambda: client.robot("tedusar").value["agents"], "the agent", 60)
            with starved(agent.pid):
                until(since, "that it is starved", 60)
                words = f"the computer of agent onboard has been overloaded since {since()[11:19]}"
                robot = client.robot("tedusar").value
                page = httpx.get(f"{url}/ui/robots/tedusar").text
                assert run(["status", "tedusar", "--url", url]) in (0, 3)
                status = " ".join(capsys.readouterr().out.split())
                run(["doctor", "--robot", "tedusar", "--url", url])
                doctor = " ".join(capsys.readouterr().out.split())
            assert robot["state"] in {"partly-unknown", "unknown"}  # what came last counts for some seconds
            for text in (robot["headline"], str(robot["findings"]), page, status, doctor):
                assert f"{words}: what comes late is unknown" in text
            until(lambda: not since(), "that it is starved no more", 60)
            assert "starved" not in client.robot("tedusar").value["headline"]
