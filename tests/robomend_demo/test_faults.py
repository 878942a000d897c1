"""What goes wrong on a robot of the real service: a clear message each, and the service stays up."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import SLEEPER, agent, config
from tests.clients.service_double import eventually

from robomend.cli.interrupts import Interrupts
from robomend.cli.stage import Stage, environment, python
from robomend_client.rest.sync import Client
from robomend_demo.record import FINAL

MODEL = """
robomend: 1
name: small
hardware:
  base: {channel: 7}
nodes:
  worker: {}
"""
READY = ["sh", "-c", "echo up; exec sleep 1000"]


@dataclass(frozen=True)
class Service:
    client: Client
    url: str
    pid: int


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service that has the model."""
    folder = tmp_path_factory.mktemp("service")
    with Interrupts() as interrupts, Stage(folder, environment(), interrupts) as stage:
        serve = python("robomend", "serve", "--port", "0", "--data", str(folder / "data"), "--announce")
        actor = stage.start("service", serve, announces=True)
        url = stage.announced(actor, 60.0)["url"]
        with Client(url) as client:
            client.put_model("small", MODEL)
            yield Service(client, url, actor.process.pid)


def entrust(client: Client, robot: str, observed: list[str], **more: Any) -> None:
    client.put_robot(
        robot,
        {
            "model": "small",
            "policy": "auto",
            "observed": observed,
            "observed_timeout_s": 2.0,
            "actions": {"start_node": {"timeout_s": 3.0, "effect_timeout_s": 2.0, "retries": 0}},
            **more,
        },
    )


def agent_of(tmp_path: Path, service: Service, robot: str, process: dict[str, Any]) -> Path:
    """Return the configuration of an agent with one process."""
    return config(tmp_path, service.url, {"worker": process}, robot=robot)


def ended(client: Client, robot: str, which: Callable[[dict[str, Any]], bool] = bool) -> dict[str, Any]:
    """Wait for the end of a repair, and see that the service answers others meanwhile."""
    found: list[dict[str, Any]] = []

    def look() -> bool:
        found[:] = [r for r in client.repairs(robot)["items"] if r["state"] in FINAL and which(r)]
        return bool(found)

    eventually(look, f"the end of a repair of {robot}", 60)
    answers_others(client)
    return found[0]


def answers_others(client: Client) -> None:
    """Another robot is diagnosed as if nothing were."""
    if not any(robot["id"] == "other" for robot in client.robots()["items"]):
        client.put_robot("other", {"model": "small", "policy": "observe"})
    for sentence, blamed in (("not running(worker)", ["worker"]), ("running(worker)", [])):
        revision = client.observe("other", [sentence])["revision"]
        now = client.diagnosis("other", wait_s=5.0, after=revision - 1)
        assert now["result"] is not None
        assert [one["bad"] for one in now["result"]["diagnoses"]] == [blamed]


def test_a_board_that_is_not_there_is_named_as_what_nobody_hears_of(service: Service) -> None:
    client = service.client
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and does not listen
        port = taken.getsockname()[1]
        entrust(client, "boardless", ["on(base)"], board={"host": "127.0.0.1", "port": port})
        client.observe("boardless", ["not running(worker)"])
        repair = ended(client, "boardless")
        assert repair["state"] == "escalated"
        assert repair["reason"].startswith("nobody reported on(base) within 2 s: start the observers")
        board = client.board("boardless")
        assert board["state"] in {"disconnected", "connecting"}
        assert "Connect" in board["reason"] or "refused" in board["reason"], board


def test_a_node_that_never_starts_is_named_with_the_agents_reason(service: Service, tmp_path: Path) -> None:
    client = service.client
    entrust(client, "stuck", ["running(worker)"])
    never = {"command": SLEEPER, "ready": {"output": "up"}, "start_timeout_s": 0.5}
    with agent(agent_of(tmp_path, service, "stuck", never)):
        repair = ended(client, "stuck")
    assert repair["state"] == "escalated"
    assert "worker gave no sign of running" in repair["reason"]


def test_an_agent_that_goes_away_in_mid_action_is_named_and_the_next_one_goes_on(
    service: Service, tmp_path: Path
) -> None:
    client = service.client
    entrust(client, "left", ["running(worker)"])
    slow = {"command": SLEEPER, "ready": {"output": "up"}, "start_timeout_s": 30.0}
    with agent(agent_of(tmp_path, service, "left", slow)) as process:
        eventually(lambda: _under_way(client, "left"), "an action that is under way", 30)
        process.kill()
        process.wait()
        first = ended(client, "left")
    assert first["state"] == "escalated"
    assert "agent" in first["reason"] or "nobody reported running(worker)" in first["reason"], first["reason"]
    # What it last said counts no longer than it said: a robot of which nothing is known is not repaired.
    eventually(lambda: not _known(client, "left"), "nothing is known of the robot", 30)
    with agent(agent_of(tmp_path, service, "left", {"command": READY, "ready": {"output": "up"}})):
        second = ended(client, "left", lambda r: r["id"] != first["id"])
        assert second["state"] == "repaired", str([second["reason"], second["rounds"]])


def _known(client: Client, robot: str) -> list[str]:
    return [one["literal"] for one in client.observations(robot)["observations"] if one["fresh"]]


def _idle(pids: list[int]) -> bool:
    """Whether these are at least two processes that did nothing for half a second."""
    before = list(map(_ticks, pids))
    time.sleep(0.5)  # processor time is counted over it
    return len(pids) >= 2 and list(map(_ticks, pids)) == before


def _ticks(pid: int) -> int:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


def _under_way(client: Client, robot: str) -> bool:
    return any(
        step["state"] == "running" for repair in client.repairs(robot)["items"] for step in repair["plan"]
    )
