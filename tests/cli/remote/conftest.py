"""A running service, in a process of its own, that the tests of these commands share; each has its robots."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR
from tests.api.test_process import served
from tests.waiting import until

from robomend.cli.commands import run
from robomend_client.rest import Client


@dataclass(frozen=True)
class Shared:
    """The service, and a client of it."""

    url: str
    client: Client

    def robot(self, robot: str, *sentences: str, **config: Any) -> None:
        """Configure a robot and observe something on it."""
        self.client.put_robot(robot, {"model": "tedusar", "detection_s": 0, **config})
        if sentences:
            revision = self.client.observe(robot, sentences)["revision"]
            self.client.diagnosis(robot, wait_s=30, after=revision - 1)

    def awaiting_approval(self, robot: str) -> str:
        """Return the repair of a robot's fault that waits for a yes."""
        self.robot(robot, "not ok(scan)")
        found: list[str] = []

        def waits() -> bool:
            newest = self.client.repairs(robot, limit=1)["items"]
            found[:] = [one["id"] for one in newest if one["state"] == "awaiting-approval"]
            return bool(found)

        until(waits, f"a repair of {robot} awaits approval", 60)
        return found[0]

    def cancelled(self, robot: str) -> str:
        """Return the repair of a robot's fault that a person has cancelled: none begins by itself."""
        repair = self.awaiting_approval(robot)
        self.client.cancel(repair, "not now")
        until(lambda: self.client.repair(repair)["finished_ns"], "it has ended")
        return repair


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shared]:
    with served(tmp_path_factory.mktemp("service")) as (_, url), Client(url) as client:
        client.put_model("tedusar", TEDUSAR)
        yield Shared(url, client)


NUMBERS = count(1)


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch, shared: Shared) -> str:
    """The id of a robot of the test's own; commands ask the shared service."""
    monkeypatch.setenv("ROBOMEND_URL", shared.url)
    monkeypatch.setenv("COLUMNS", "80")
    return f"r{next(NUMBERS)}"


Told = tuple[int, str, str]
Say = Callable[..., Told]


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str]) -> Say:
    """Runs a command and returns its exit code, what it wrote and what it said beside it."""

    def command(*arguments: str) -> Told:
        code = run(list(arguments))
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return command


def answer(told: Told) -> Any:
    """Return the JSON of a command that did what it should."""
    code, out, err = told
    assert code == 0, err
    return json.loads(out)


def narrow(text: str) -> bool:
    """Return whether a text fits 80 columns."""
    return all(len(line) <= 80 for line in text.splitlines())


@pytest.fixture
def configuration(tmp_path: Path) -> Path:
    """A robot's configuration as a file."""
    file = tmp_path / "robot.yaml"
    file.write_text("model: tedusar\nobserved: [ok(scan)]\nexpected: {stopped: [rviz]}\nhold_s: 1.5\n")
    return file
