"""What the power board measures, for observers of an agent: the service alone is connected to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.clients.running_agent import agent, config
from tests.service.board_robot import robot_with_board
from tests.waiting import until

MODEL = {
    "robomend": 1,
    "name": "bot",
    "hardware": {"lamp": {"channel": 3}},
    "properties": {"lamp_draws": {}, "lamp_volts": {}, "fan": {}},
}


def test_any_observer_of_an_agent_may_judge_what_the_board_measures(tmp_path: Path) -> None:
    with robot_with_board(tmp_path, MODEL) as robot:
        client = robot.client
        judged = {"lamp_draws": "current(lamp)", "lamp_volts": "voltage(3)", "fan": "current(fan)"}
        observers: dict[str, Any] = {
            name: {"kind": "property", "from": "board", "source": f"board:{what}", "low": 0.01}
            for name, what in judged.items()
        }

        def obs() -> set[str]:
            found = client.observations("tedusar")["observations"]
            return {one["literal"] for one in found if one["fresh"] and one["source"] == "agent onboard"}

        with agent(config(tmp_path, robot.url, {}, observers=observers, board={"rate_hz": 10})):
            until(lambda: obs() == {"ok(lamp_draws)", "ok(lamp_volts)"}, "what it draws", 60)
            client.switch_channel("tedusar", 3, False)
            until(lambda: "not ok(lamp_draws)" in obs(), "that it draws nothing", 60)
        log = (tmp_path / "agent.log").read_text()
        assert log.count("board:current(fan): no current of fan: no channel of the board") == 1
