"""A robot of which the service watches an emulated board, with what is on its channel 3."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from subprocess import Popen
from typing import Any

from tests.api.test_process import served
from tests.robomend_board.processes import Running
from tests.robomend_board.processes import running as emulator

from robomend_client.rest.sync import Client


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
