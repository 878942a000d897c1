"""What the power board measures, for observers of an agent: the service alone is connected to it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.api.test_process import served
from tests.clients.running_agent import agent, config
from tests.robomend_board.processes import running as emulator
from tests.waiting import until

from robomend_client.rest.sync import Client

MODEL = {
    "robomend": 1,
    "name": "bot",
    "hardware": {"lamp": {"channel": 3}},
    "properties": {"lamp_draws": {}, "lamp_volts": {}, "fan": {}},
}


def test_any_observer_of_an_agent_may_judge_what_the_board_measures(tmp_path: Path) -> None:
    with (
        emulator("--on", "3") as board,
        served(tmp_path) as (_, url),
        Client(url) as client,
    ):
        client.put_model("bot", json.dumps(MODEL))
        at = {"host": "127.0.0.1", "port": board.port, "protected": [], "rate_hz": 10}
        client.put_robot("tedusar", {"model": "bot", "policy": "observe", "board": at})
        judged = {"lamp_draws": "current(lamp)", "lamp_volts": "voltage(3)", "fan": "current(fan)"}
        observers: dict[str, Any] = {
            name: {"kind": "property", "from": "board", "source": f"board:{what}", "low": 0.01}
            for name, what in judged.items()
        }

        def obs() -> set[str]:
            found = client.observations("tedusar")["observations"]
            return {one["literal"] for one in found if one["fresh"] and one["source"] == "agent onboard"}

        with agent(config(tmp_path, url, {}, observers=observers, board={"rate_hz": 10})):
            until(lambda: obs() == {"ok(lamp_draws)", "ok(lamp_volts)"}, "what it draws", 60)
            client.switch_channel("tedusar", 3, False)
            until(lambda: "not ok(lamp_draws)" in obs(), "that it draws nothing", 60)
        log = (tmp_path / "agent.log").read_text()
        assert log.count("board:current(fan): no current of fan: no channel of the board") == 1
