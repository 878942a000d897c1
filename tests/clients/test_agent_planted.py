"""What a drill plants in an agent's processes is on disk before, and undone whatever happens to the agent."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import SLEEPER, agent, alive, config
from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.waiting import eventually as soon

from robomend_client.actions import OK, REFUSED, UNDONE_BEFORE
from robomend_client.agent.config import ProcessSpec
from robomend_client.agent.planted import KINDS, PlantedFaults
from robomend_client.agent.processes import SupervisedProcess
from robomend_client.python310 import end


@pytest.fixture
def service() -> Iterator[ServiceDouble]:
    with service_double() as service:
        yield service


def node(tmp_path: Path) -> dict[str, Any]:
    """Return the processes of an agent with one node, `walker`, that writes its pid."""
    write = f"import os; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); "
    command = [SLEEPER[0], "-c", write + "import time; time.sleep(1000)"]
    return {"walker": {"command": command, "start": True, "ready": "exec"}}


def pid(tmp_path: Path, other_than: int = 0) -> int:
    """Return the node's process once it has written it."""

    def written() -> int:
        text = (tmp_path / "pid").read_text() if (tmp_path / "pid").exists() else ""
        return int(text) if text and int(text) != other_than else 0

    eventually(written, "a pid")
    return written()


def halted(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].split()[0] == b"T"
    except OSError:
        return False


def leases(tmp_path: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((tmp_path / "state" / "planted.json").read_text())["faults"]
    return found


def test_a_halted_process_goes_on_and_a_killed_one_is_started(tmp_path: Path, service: ServiceDouble) -> None:
    with agent(config(tmp_path, service.url, node(tmp_path))):
        first = pid(tmp_path)
        wanted = {"plant_fault:walker", "undo_fault:walker"}
        eventually(lambda: service.polls and wanted <= set(service.polls[-1]["can"]), "both are offered")
        done = service.do("d:1", "plant_fault", "walker", "node-frozen", "60")
        assert (done["code"], halted(first)) == (OK, True)
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


@pytest.mark.parametrize("kind", ["node-killed", "node-frozen"])
def test_what_an_agent_that_was_killed_had_planted_the_next_one_undoes(
    tmp_path: Path, service: ServiceDouble, kind: str
) -> None:
    file = config(tmp_path, service.url, node(tmp_path), when_agent_ends="keep")
    with agent(file) as running:
        first = pid(tmp_path)
        assert service.do("d:1", "plant_fault", "walker", kind, "60")["code"] == OK
        running.send_signal(signal.SIGKILL)
        running.wait(20)
    with agent(file):
        eventually(lambda: leases(tmp_path) == [], "the lease is over")
        now = first if kind == "node-frozen" else pid(tmp_path, other_than=first)
        assert (alive(now), halted(now)) == (True, False)
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
        running.wait(20)
    with agent(file):
        eventually(lambda: len(asked) >= 2, "the agent has asked twice")
        assert halted(first)
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
