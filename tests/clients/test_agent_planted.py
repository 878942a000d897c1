"""What a drill plants through an agent is on disk before, and undone whatever happens to the agent."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import SLEEPER, WRITES_PID, agent, alive, config, halted, marked
from tests.clients.service_double import ServiceDouble, eventually
from tests.waiting import eventually as soon

from robomend_client.actions import OK, REFUSED, UNDONE_BEFORE
from robomend_client.agent.config import ProcessSpec
from robomend_client.agent.planted import KINDS, PlantedFaults
from robomend_client.agent.processes import SupervisedProcess
from robomend_client.python310 import end


def node(tmp_path: Path, *names: str) -> dict[str, Any]:
    """Return the processes of an agent with these nodes, or with `walker`, which write their numbers."""
    write = WRITES_PID + "time.sleep(1000)"
    return {
        name: {"command": [*SLEEPER[:2], write, str(tmp_path / name)], "start": True, "ready": "exec"}
        for name in names or ("walker",)
    }


def pid(tmp_path: Path, other_than: int = 0, name: str = "walker") -> int:
    """Return the node's process once it has written it."""

    def written() -> int:
        text = (tmp_path / name).read_text() if (tmp_path / name).exists() else ""
        return int(text) if text and int(text) != other_than else 0

    eventually(written, "a pid")
    return written()


def leases(tmp_path: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((tmp_path / "state" / "planted.json").read_text())["faults"]
    return found


def test_a_halted_process_goes_on_and_a_killed_one_is_started(tmp_path: Path, service: ServiceDouble) -> None:
    with agent(config(tmp_path, service.url, node(tmp_path))):
        first = pid(tmp_path)
        wanted = {"plant_fault:walker", "undo_fault:walker"}
        eventually(lambda: service.polls and wanted <= set(service.polls[-1]["can"]), "both are offered")
        assert service.do("d:1", "plant_fault", "walker", "node-frozen", "60")["code"] == OK
        eventually(lambda: halted(first), "it has come to the signal")
        assert [one["component"] for one in leases(tmp_path)] == ["walker"]
        assert service.do("d:2", "plant_fault", "walker", "node-killed", "60")["code"] == REFUSED
        assert service.do("d:3", "undo_fault", "walker", "node-frozen")["code"] == OK
        assert (halted(first), alive(first), leases(tmp_path)) == (False, True, [])
        assert service.do("d:4", "undo_fault", "walker", "node-frozen")["code"] == UNDONE_BEFORE

        assert service.do("d:5", "plant_fault", "walker", "node-killed", "60")["code"] == OK
        assert not alive(first)
        assert service.do("d:6", "plant_fault", "walker", "node-frozen", "60")["code"] == REFUSED
        assert service.do("d:7", "undo_fault", "walker", "node-killed")["code"] == OK
        assert alive(pid(tmp_path, other_than=first))
        assert service.do("d:8", "plant_fault", "walker", "node-bored", "60")["code"] == REFUSED
        assert service.do("d:9", "plant_fault", "walker", "node-frozen", "86400")["code"] == REFUSED


def test_a_mute_process_stands_in_until_the_undo_or_a_repair(tmp_path: Path, service: ServiceDouble) -> None:
    with agent(config(tmp_path, service.url, node(tmp_path))):
        first = pid(tmp_path)
        eventually(lambda: service.holds().get("running(walker)"), "it runs")
        assert service.do("d:1", "plant_fault", "walker", "node-mute", "60")["code"] == OK
        assert not alive(first)
        [lease] = leases(tmp_path)
        assert alive(lease["pid"])
        assert "stand_in" in Path(f"/proc/{lease['pid']}/cmdline").read_text()
        heard = len(service.batches())
        eventually(lambda: len(service.batches()) >= heard + 2, "what its observers say now")
        assert "not running(walker)" not in str(service.batches())
        assert service.do("d:2", "undo_fault", "walker", "node-mute")["code"] == OK
        second = pid(tmp_path, other_than=first)
        assert (alive(second), alive(lease["pid"]), leases(tmp_path)) == (True, False, [])

        assert service.do("d:3", "plant_fault", "walker", "node-mute", "60")["code"] == OK
        [lease] = leases(tmp_path)
        assert service.do("d:4", "stop_node", "walker")["code"] == OK  # as a repair does
        assert service.do("d:5", "start_node", "walker")["code"] == OK
        third = pid(tmp_path, other_than=second)
        assert service.do("d:6", "undo_fault", "walker", "node-mute")["code"] == OK
        assert (alive(third), alive(lease["pid"])) == (True, False)
        assert service.do("d:7", "stop_node", "walker")["code"] == OK
        assert service.do("d:8", "plant_fault", "walker", "node-mute", "60")["code"] == REFUSED
        assert leases(tmp_path) == []


def test_topics_of_the_agents_bus_may_be_disturbed_and_a_node_may_have_the_same_name(
    tmp_path: Path, service: ServiceDouble
) -> None:
    more = {"topics": {"walker": {"rate_hz": 10}, "scan": {"rate_hz": 10}}}
    with agent(config(tmp_path, service.url, node(tmp_path), **more)):
        pid(tmp_path)
        wanted = {"plant_fault:walker", "plant_fault:scan", "undo_fault:scan"}
        eventually(lambda: service.polls and wanted <= set(service.polls[-1]["can"]), "both are offered")
        assert service.do("d:1", "plant_fault", "scan", "topic-dropped", "60")["code"] == OK
        assert service.do("d:2", "plant_fault", "scan", "topic-delayed", "60")["code"] == REFUSED
        assert service.do("d:3", "plant_fault", "walker", "topic-delayed", "60")["code"] == OK
        assert service.do("d:4", "plant_fault", "walker", "node-frozen", "60")["code"] == OK
        assert len(leases(tmp_path)) == 3
        assert service.do("d:5", "undo_fault", "walker", "topic-delayed")["code"] == OK
        assert [one["kind"] for one in leases(tmp_path)] == ["topic-dropped", "node-frozen"]
        assert service.do("d:6", "undo_fault", "walker", "node-frozen")["code"] == OK
        assert service.do("d:7", "undo_fault", "scan", "topic-dropped")["code"] == OK
        assert service.do("d:8", "undo_fault", "scan", "topic-dropped")["code"] == UNDONE_BEFORE
        assert service.do("d:9", "plant_fault", "scan", "node-killed", "60")["code"] == REFUSED
        assert service.do("d:10", "plant_fault", "odom", "topic-dropped", "60")["code"] == REFUSED


def test_an_agent_that_joins_the_bus_of_another_disturbs_no_topic(
    tmp_path: Path, service: ServiceDouble
) -> None:
    more = {"topics": {"scan": {"rate_hz": 10}}, "bus": {"join": "tcp:127.0.0.1:9"}}
    with agent(config(tmp_path, service.url, node(tmp_path), **more)):
        eventually(lambda: service.polls, "it asks for work")
        assert "plant_fault:walker" in service.polls[-1]["can"]
        assert "plant_fault:scan" not in service.polls[-1]["can"]


def test_what_an_agent_that_was_killed_had_planted_the_next_one_undoes(
    tmp_path: Path, service: ServiceDouble
) -> None:
    file = config(tmp_path, service.url, node(tmp_path, *KINDS), when_agent_ends="keep")
    with agent(file) as running:
        first = {kind: pid(tmp_path, name=kind) for kind in KINDS}
        for kind in KINDS:
            assert service.do(f"d:{kind}", "plant_fault", kind, kind, "60")["code"] == OK
        [stand_in] = [lease["pid"] for lease in leases(tmp_path) if lease["kind"] == "node-mute"]
        running.send_signal(signal.SIGKILL)
        running.wait(60)
    eventually(lambda: not alive(stand_in), "the stand-in ends with its agent")
    with agent(file):
        eventually(lambda: leases(tmp_path) == [], "the leases are over")
        for kind in KINDS:
            other = 0 if kind == "node-frozen" else first[kind]
            now = pid(tmp_path, other_than=other, name=kind)
            assert (now == first[kind]) is (kind == "node-frozen")
            assert (alive(now), halted(now)) == (True, False)
            eventually(lambda: marked(str(tmp_path / kind)) == [now], "no other process is left")  # noqa: B023  # at once
            os.kill(now, signal.SIGKILL)


def test_the_next_agent_undoes_nothing_during_the_global_stop(tmp_path: Path, service: ServiceDouble) -> None:
    """Nor does it where the service, which said so last, does not answer any more."""
    active: list[bool | None] = [True]  # None: the service does not answer
    asked: list[float] = []

    def answers(method: str, path: str) -> tuple[int, Any] | None:
        if not path.endswith("/stop"):
            return None
        asked.append(time.monotonic())
        return (200, {"active": active[0]}) if active[0] is not None else (500, {"code": "x", "detail": "x"})

    service.answers = answers
    file = config(tmp_path, service.url, node(tmp_path), when_agent_ends="keep")
    with agent(file) as running:
        first = pid(tmp_path)
        assert service.do("d:1", "plant_fault", "walker", "node-frozen", "60")["code"] == OK
        running.send_signal(signal.SIGKILL)
        running.wait(60)
    with agent(file):
        eventually(lambda: len(asked) >= 2, "the agent has asked twice")
        eventually(lambda: halted(first), "it has come to the signal")
        active[0] = None
        seen = len(asked)
        eventually(lambda: len(asked) >= seen + 2, "and twice more")
        assert halted(first)
        active[0] = False
        eventually(lambda: not halted(first), "it goes on")
        eventually(lambda: leases(tmp_path) == [], "the lease is over")
    os.kill(first, signal.SIGKILL)


def test_an_agent_that_ends_in_order_lets_go_on_what_it_halted(
    tmp_path: Path, service: ServiceDouble
) -> None:
    with agent(config(tmp_path, service.url, node(tmp_path), when_agent_ends="keep")):
        first = pid(tmp_path)
        assert service.do("d:1", "plant_fault", "walker", "node-frozen", "60")["code"] == OK
    assert (alive(first), halted(first), leases(tmp_path)) == (True, False, [])
    os.kill(first, signal.SIGKILL)


@pytest.mark.anyio
@pytest.mark.parametrize("kind", KINDS)
async def test_a_lease_that_is_over_is_undone_by_the_agent_itself(tmp_path: Path, kind: str) -> None:
    process = SupervisedProcess(ProcessSpec("walker", tuple(SLEEPER)), os.environ, lambda _: None)
    await process.start(lambda number, message: None, 20.0)
    assert process.handle is not None
    first = process.handle.pid

    async def stopped() -> bool:
        return False

    planted = PlantedFaults(tmp_path / "planted.json", {"walker": process}, stopped)
    looking = asyncio.create_task(planted.run())
    try:
        assert (await planted.plant("walker", kind, 0.2)).ok
        await soon(lambda: not planted.leases, "the lease is over")
        assert process.handle is not None
        assert not halted(process.handle.pid)
        assert (process.handle.pid == first) is (kind == "node-frozen")
        assert (await planted.undo("walker", kind, 5.0)).code == UNDONE_BEFORE
    finally:
        await end([looking])
        await process.stop(lambda number, message: None, 20.0)


def test_a_lease_file_that_cannot_be_read_stops_no_agent(tmp_path: Path, service: ServiceDouble) -> None:
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "planted.json").write_text("torn")
    with agent(config(tmp_path, service.url, node(tmp_path))):
        assert service.do("d:1", "plant_fault", "walker", "node-frozen", "60")["code"] == OK
        assert service.do("d:2", "undo_fault", "walker", "node-frozen")["code"] == OK
