"""A long action is withdrawn from a real `robomend-agent` by the real service, and nothing acts twice."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import agent, alive, config
from tests.repairs.remote import ended, latest, services
from tests.waiting import eventually

pytestmark = pytest.mark.anyio

MODEL = """
robomend: 1
name: one-node
nodes:
  laser: {publishes: {scan: []}}
"""

LASER = """
import os, pathlib, sys, time
folder = pathlib.Path(sys.argv[1])
with (folder / "starts").open("a") as starts:
    starts.write(f"{os.getpid()}\\n")
while not (folder / "may-start").exists():
    time.sleep(0.02)
print("ready", flush=True)
time.sleep(1000)
"""


async def test_a_start_under_way_is_given_up_and_done_once_when_it_is_wanted_again(tmp_path: Path) -> None:
    laser = {
        "command": [sys.executable, "-c", LASER, str(tmp_path)],
        "ready": {"output": "ready"},
        "start_timeout_s": 120,
    }

    def starts() -> list[int]:
        file = tmp_path / "starts"
        return [int(line) for line in file.read_text().split()] if file.exists() else []

    def says_what_it_waits_for(repair: dict[str, Any]) -> bool:
        feedback = repair["plan"][0]["feedback"] if repair["plan"] else None
        said = f"laser has process {starts()[0]}; waiting for evidence: output"
        return feedback is not None and (feedback["code"], feedback["message"]) == (1, said)

    async with services(("--data", str(tmp_path / "service"))) as [service]:
        client = service.client
        assert client is not None
        await client.put_model("one-node", MODEL)
        slow = {"timeout_s": 120.0, "effect_timeout_s": 10.0}
        robot = {
            "model": "one-node",
            "policy": "auto",
            "observed": ["running(laser)"],
            "actions": {"start_node": slow},
        }
        await client.put_robot("tedusar", robot)
        with agent(config(tmp_path, service.url, {"laser": laser})):
            await eventually(starts, "it was started", 120)
            under_way = await latest([service], lambda repair: repair["state"] == "running", robot="tedusar")
            await latest([service], says_what_it_waits_for, robot="tedusar")
            await client.stop("people on the floor")
            await eventually(lambda: not any(map(alive, starts())), "it was given up", 120)
            over = await latest([service], ended, robot="tedusar")
            assert (over["id"], over["state"]) == (under_way["id"], "cancelled")
            assert [step["result"] for step in over["plan"]] == [5]
            assert len(starts()) == 1
            (tmp_path / "may-start").touch()
            await client.resume()
            repair = await latest(
                [service], lambda r: ended(r) and r["id"] != under_way["id"], robot="tedusar"
            )
            assert (repair["state"], len(starts())) == ("repaired", 2)
            assert [alive(pid) for pid in starts()] == [False, True]
