"""An agent whose computer's clock is wrong, or is set while it runs: what the service makes of it."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.api.test_process import served
from tests.clients.talker import Talker, watching
from tests.waiting import until
from tests.wrong_clock import WrongClock

from robomend_client.rest.sync import Client

MODEL = {"robomend": 1, "name": "bot", "nodes": {"laser": {"publishes": {"scan": []}}}}
SCAN = {"tolerance_hz": 8, "silence_s": 3}
"""The talker may be late, on a busy computer; a clock is set by much more."""

NEAR_NS = 20 * 10**9
"""Less than any clock here is wrong by, and more than a busy computer takes."""


class Told:
    """What the service holds of the topic."""

    def __init__(self, client: Client, log: Path) -> None:
        self._client = client
        self._log = log

    def entry(self) -> dict[str, Any]:
        """Return the literal and its evidence; nothing where it is unknown."""
        found = self._client.observations("tedusar")["observations"]
        return next((dict(one) for one in found if one["fresh"]), {"literal": ""})

    def said(self, literal: str) -> dict[str, Any]:
        """Wait until the service holds this by evidence that is young; return it."""
        entry: dict[str, Any] = {}

        def is_so() -> bool:
            entry.update(self.entry())
            return bool(entry["literal"] == literal and entry["since_ns"] > time.time_ns() - NEAR_NS)

        until(is_so, literal, 60)
        return entry

    def history(self) -> str:
        """Return all that was ever accepted."""
        return str(self._client.history("tedusar", limit=1000))

    def lines(self, part: str) -> list[str]:
        """Return the lines of the agent's log that have this in them."""
        return re.findall(rf".*{part}.*", self._log.read_text())


@contextmanager
def told_by(folder: Path, clock: WrongClock) -> Iterator[tuple[Told, Talker, Any]]:
    """A service, and an agent that lives by this clock."""
    with served(folder) as (_, url), Client(url) as client:
        client.put_model("bot", json.dumps(MODEL))
        client.put_robot("tedusar", {"model": "bot", "policy": "observe"})
        with watching(folder, url, clock.environment, topics={"scan": SCAN}) as (process, talker):
            yield Told(client, folder / "agent.log"), talker, process


def falls_silent(told: Told, talker: Talker) -> None:
    """The topic falls silent, which is told by times of the service's clock."""
    while True:
        last_ns = talker.hush("scan")
        silent = told.said("not ok(scan)")
        if silent["onset_ns"] is not None:
            break
        talker.say("scan")  # an agent that was late itself does not know when it heard the last one
        told.said("ok(scan)")
    assert silent["since_ns"] <= time.time_ns() + 10**9
    assert abs(silent["onset_ns"] - last_ns) < NEAR_NS


@pytest.mark.parametrize("ahead_s", [-600, -30, 30])
def test_times_of_an_agent_whose_clock_is_wrong_are_brought_to_the_services(
    ahead_s: float, tmp_path: Path
) -> None:
    with told_by(tmp_path, WrongClock(tmp_path, ahead_s)) as (told, talker, process):
        talker.say("scan")
        well = told.said("ok(scan)")
        assert well["expires_ns"] < time.time_ns() + NEAR_NS
        falls_silent(told, talker)
        process.kill()
        until(lambda: told.entry()["literal"] == "", "what a dead agent said is unknown", 60)
        assert told.lines("the service refused") == []


def test_an_agent_whose_clock_is_minutes_ahead_is_refused_and_told_once_until_it_is_set_right(
    tmp_path: Path,
) -> None:
    clock = WrongClock(tmp_path)
    with told_by(tmp_path, clock) as (told, talker, _):
        talker.say("scan")
        told.said("ok(scan)")
        clock.set(600)
        until(lambda: len(told.lines("the service refused")) > 2, "more than one refusal", 60)
        until(lambda: told.entry()["literal"] == "", "what is not said again is unknown", 60)
        (first,) = told.lines("ERROR .*the service refused")
        assert "s ahead of this service's clock; 60 are allowed" in first
        clock.set(0)
        told.said("ok(scan)")
        falls_silent(told, talker)
        assert len(told.lines("the clock was set ahead by")) == 1
        assert len(told.lines("the clock went back by")) == 1


def test_an_agent_whose_clock_is_set_back_by_minutes_goes_on_as_if_it_were_not(tmp_path: Path) -> None:
    clock = WrongClock(tmp_path)
    with told_by(tmp_path, clock) as (told, talker, _):
        talker.say("scan")
        told.said("ok(scan)")
        clock.set(-600)
        for _ in range(3):  # heartbeats
            before_ns = told.said("ok(scan)")["time_ns"]
            until(lambda: told.entry().get("time_ns", 0) > before_ns, "a heartbeat", 60)  # noqa: B023  # at once
        assert "not ok(scan)" not in told.history()
        falls_silent(told, talker)
        assert told.lines("the clock") == []
        assert told.lines("the service refused") == []
