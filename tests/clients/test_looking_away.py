"""Who looked away, was halted or lost its connection says that nothing is known: never that all is silent.

The bus, the board, the agent itself, and feeds that fail; bridges/test_looking_away.py has ROS 1, ROS 2 and
zenoh, bridges/medkit/ has ros2_medkit.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import SLEEPER, agent, config
from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.clients.talker import Talker, watching
from tests.distributions import install
from tests.medkit_gateway import medkit_gateway
from tests.network import own_port

from robomend_client.agent.watch import Watch
from robomend_client.clock import Clock
from robomend_client.observers import GeneralObserver

OBSERVED: dict[str, Any] = {
    "topics": {"scan": {"tolerance_hz": 8, "silence_s": 0.7}},  # the talker may be late, on a busy computer
    "observers": {"level": {"kind": "property", "source": "tank:level", "low": 1, "lifetime_s": 3}},
}
WELL = {"ok(scan)": True, "ok(level)": True}
LONG_S = 6.0


def said_bad(service: ServiceDouble, since: int = 0) -> set[str]:
    """Return what was said to be bad, from that batch on."""
    batches = service.batches()[since:]
    return {literal for batch in batches for literal in batch["observations"] if "not " in literal}


def talk(talker: Talker) -> None:
    talker.say("scan")
    talker.say("tank", data={"level": 2})


@contextmanager
def listening_in(folder: Path, service: ServiceDouble) -> Iterator[tuple[Any, Talker]]:
    """Run an agent that has a bus, somebody who talks on it, and an agent that listens in on it."""
    address = f"tcp:127.0.0.1:{own_port()}"
    for name in ("owner", "other"):
        (folder / name).mkdir()
    owner = config(folder / "owner", service.url, {}, bus={"listen": address}, agent="owner")
    other = config(folder / "other", service.url, {}, bus={"join": address}, agent="other", **OBSERVED)
    with agent(owner) as owning, agent(other):
        talker = Talker(address)
        try:
            talk(talker)
            eventually(lambda: WELL.items() <= service.holds().items(), "all well", 60)
            yield owning, talker
            eventually(lambda: WELL.items() <= service.signs().items(), "all well again", 60)
        finally:
            talker.close()


def test_a_bus_whose_agent_is_halted_is_unknown_and_none_of_its_topics_silent_as_one_that_is_heard(
    tmp_path: Path,
) -> None:
    unknown = {"ok(scan)": None, "ok(level)": None}
    with service_double() as service, listening_in(tmp_path, service) as (owning, talker):
        batches = len(service.batches())
        owning.send_signal(signal.SIGSTOP)
        try:
            eventually(lambda: unknown.items() <= service.signs().items(), "nothing is known", 60)
        finally:
            owning.send_signal(signal.SIGCONT)
        eventually(lambda: WELL.items() <= service.signs().items(), "all well again", 60)
        assert said_bad(service, batches) == set()
        talker.hush("scan")
        eventually(lambda: service.signs().get("ok(scan)") is False, "silence", 60)
        assert service.signs().get("ok(level)") is True
        talker.say("scan")


def test_a_service_that_is_halted_leaves_what_the_board_measures_unknown(tmp_path: Path) -> None:
    channel = {"channel": 0, "component": "motor", "on": True, "current_a": 1.0, "voltage_v": 24.0}
    observers = {
        "board": {"kind": "hardware", "from": "board", "wiring": {"motor": {"channel": 0}}, "lifetime_s": 60},
        "pack": {
            "kind": "property",
            "from": "board",
            "source": "board:voltage(0)",
            "low": 20,
            "lifetime_s": 60,
        },
    }
    goes_on, measured_ns = threading.Event(), [1]
    goes_on.set()

    def answer(method: str, path: str) -> tuple[int, Any] | None:
        if not path.endswith("/board"):
            return None
        goes_on.wait(60)  # halted, it has taken the question, and says nothing
        return 200, {"time_ns": measured_ns[0], "channels": [channel]}

    with service_double() as service:
        service.answers = answer
        with agent(config(tmp_path, service.url, {}, observers=observers)):
            well = {"on(motor)": True, "ok(pack)": True}
            eventually(lambda: well.items() <= service.signs().items(), "all well", 60)
            goes_on.clear()
            unknown = dict.fromkeys(well)
            eventually(lambda: unknown.items() <= service.signs().items(), "nothing is known", 60)
            measured_ns[0] = 2
            goes_on.set()
            eventually(lambda: well.items() <= service.signs().items(), "all well again", 60)
    assert said_bad(service) == set()


def test_an_agent_that_was_halted_finds_all_as_it_was(tmp_path: Path) -> None:
    """Whatever it was halted in the middle of: a question, its answer, a stream of events, a message."""
    channel = {"channel": 0, "component": "motor", "on": True, "current_a": 1.0, "voltage_v": 24.0}
    board: dict[str, Any] = {"from": "board", "lifetime_s": 60}
    observers = {
        **OBSERVED["observers"],
        "board": {**board, "kind": "hardware", "wiring": {"motor": {"channel": 0}}},
        "pack": {**board, "kind": "property", "source": "board:voltage(0)", "low": 20},
        "lidar_driver": {"kind": "diagnostic", "from": "medkit", "status": ["lidar_driver"]},
    }
    well = dict.fromkeys((*WELL, "running(laser)", "on(motor)", "ok(pack)", "ok(lidar_driver)"), True)

    def answer(method: str, path: str) -> tuple[int, Any] | None:
        now = {"time_ns": time.time_ns(), "channels": [channel]}
        return (200, now) if path.endswith("/board") else None

    with service_double() as service, medkit_gateway() as gateway:
        service.answers = answer
        sections: dict[str, Any] = {
            "medkit": {"url": gateway.url, "poll_s": 0.2},
            "board": {"rate_hz": 20},
            "processes": {"laser": {"command": SLEEPER, "start": True}},
            "topics": OBSERVED["topics"],
            "observers": observers,
        }
        with watching(tmp_path, service.url, **sections) as (halted, talker):
            talk(talker)
            eventually(lambda: well.items() <= service.signs().items(), "all well", 60)
            well_by = len(service.batches())
            for halted_s in (LONG_S, 1.7, 0.8):
                halted.send_signal(signal.SIGSTOP)
                time.sleep(halted_s)  # longer than any silence at first: time itself is what passes unseen
                batches = len(service.batches())
                halted.send_signal(signal.SIGCONT)
                eventually(lambda n=batches: len(service.batches()) > n + 3, "more of it", 60)  # type: ignore[misc]  # bound for this round
                eventually(lambda: well.items() <= service.signs().items(), "all well again", 60)
    assert said_bad(service, well_by) == set()


TIN_CAN = """
import asyncio

class TinCan:
    def __init__(self, section, base, sources):
        self.string_s, self.sources = section.number("string_s", 10.0), sources

    async def run(self, deliver):
        for _ in range(round(10 * self.string_s)):
            for source in self.sources:
                deliver(source, None, None)
            await asyncio.sleep(0.1)
        raise ZeroDivisionError("mine")
"""
"""A feed of another distribution, which fails after a while."""


def test_a_feed_of_another_distribution_is_heard_and_what_it_fed_is_unknown_once_it_has_failed(
    service: ServiceDouble, tmp_path: Path
) -> None:
    site = install(tmp_path / "site", "tin_cans", TIN_CAN, {"robomend.feeds": {"tin_can": "TinCan"}})
    path = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))
    topics = {"scan": {"from": "tin_can", "tolerance_hz": 8}}
    file = config(tmp_path, service.url, {}, topics=topics, tin_can={"string_s": 3})
    with agent(file, {**os.environ, "PYTHONPATH": path}) as process:
        eventually(lambda: service.signs().get("ok(scan)"), "it is heard")
        eventually(lambda: service.signs()["ok(scan)"] is None, "nobody looks any more")
        assert process.poll() is None
    assert said_bad(service) == set()
    assert "the feed TinCan failed" in (tmp_path / "agent.log").read_text()


def test_a_feed_that_cannot_be_read_is_told_once_and_the_others_are_read_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Reading:
        reads = 0

        def read_now(self) -> None:
            self.reads += 1

    class Broken(Reading):
        def read_now(self) -> None:
            super().read_now()
            raise ZeroDivisionError("mine")

    broken, good = Broken(), Reading()
    watch = Watch([GeneralObserver("scan")], Clock(), lambda changes: None)
    watch.read(broken, ["scan"])
    watch.read(good, [])
    for n in range(3):
        watch.settle(n, ())
    assert (broken.reads, good.reads) == (1, 3)
    assert [record.message for record in caplog.records] == [
        "the feed Broken failed, and is not read any more"
    ]
