"""A repair that protection stands in the way of is not begun: a person hears why."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.repairs.robot import CONFIG, service, the_repair

from robomend.robots.batches import Batch

pytestmark = pytest.mark.anyio

TIED = """
robomend: 1
name: tied
nodes:
  moveit: {publishes: {plan: []}}
  traj_ctl: {publishes: {cmd: [plan]}, tied_to: [moveit], protected: true}
"""


async def test_a_node_is_not_restarted_if_a_protected_one_would_have_to_restart_after_it(
    tmp_path: Path,
) -> None:
    seen = ("running(moveit)", "running(traj_ctl)", "not ok(plan)")
    async with service(tmp_path) as runtime:
        await runtime.robots.models.put("tied", TIED, format=None, expected=None, by="test")
        config = {**CONFIG, "model": "tied", "observed": [*seen[:2], "ok(plan)"]}
        await runtime.robots.put_robot("r1", config, expected=None, by="test")
        await runtime.robots.observe("r1", Batch(seen, source="test"))
        repair = await the_repair(runtime)
        assert await runtime.repairs.orders("r1", host=None, wait_s=0.0) is None
    assert repair["state"] == "escalated"
    assert "stop_node(moveit) is refused: traj_ctl, tied to it, is protected" in repair["reason"]
    assert repair["plan"] == []
