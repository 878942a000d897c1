"""POST /robots/{robot}/plans: what would be done now."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import MODEL, service

from robomend.cli.commands import run
from robomend.errors import UnknownComponent
from robomend.robots.batches import Batch

pytestmark = pytest.mark.anyio


def timeless(answer: Any) -> dict[str, Any]:
    assert answer["plan"]["elapsed_s"] >= 0
    return {**answer, "plan": {**answer["plan"], "elapsed_s": None}}


async def test_a_plan_reads_as_that_of_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = ["on(base)", "running(base_node)", "not ok(odom)"]
    async with service(tmp_path / "data") as runtime:
        await runtime.robots.models.put("small", MODEL, format=None, expected=None, by="test")
        await runtime.robots.put_robot("r1", {"model": "small"}, expected=None, by="test")
        await runtime.robots.observe("r1", Batch(tuple(seen)))
        await runtime.robots.diagnosed("r1")
        would = await runtime.repairs.plan("r1", bad=None, planner="asp", timeout_s=20.0, pddl=True)
        for_two = await runtime.repairs.plan(
            "r1", bad=["mapping", "lidar"], planner="asp", timeout_s=20.0, pddl=False
        )
        with pytest.raises(UnknownComponent, match="did you mean 'lidar'"):
            await runtime.repairs.plan("r1", bad=["lida"], planner=None, timeout_s=20.0, pddl=False)
    file = tmp_path / "small.yaml"
    file.write_text(MODEL)
    capsys.readouterr()
    observed = [word for sentence in seen for word in ("-o", sentence)]
    asked = ["plan", str(file), "--planner", "asp", "--format", "json", *observed]
    assert await asyncio.to_thread(run, [*asked, "--pddl"]) == 0
    assert timeless(json.loads(capsys.readouterr().out)) == timeless(would)
    assert await asyncio.to_thread(run, [*asked, "--bad", "mapping", "--bad", "lidar"]) == 0
    assert timeless(json.loads(capsys.readouterr().out)) == timeless(for_two)
