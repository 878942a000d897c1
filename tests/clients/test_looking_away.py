"""Who looked away, was halted or lost its connection says that nothing is known: never that all is silent.

The bus, the board, the agent itself, and feeds that fail; bridges/test_looking_away.py has ROS 1, ROS 2 and
zenoh, bridges/medkit/ has ros2_medkit.
"""

from __future__ import annotations

import asyncio
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.clients.running_agent import SLEEPER, agent, config
from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.clients.talker import Talker, free_port, watching
from tests.medkit_gateway import medkit_gateway

from robomend_client.agent.agent import _fed
from robomend_client.agent.feeds import Deliver
from robomend_client.agent.watch import Watch
from robomend_client.clock import Clock
from robomend_client.observers import Change, GeneralObserver, Rate

OBSERVED: dict[str, Any] = {
    "topics": {"scan": {"tolerance_hz": 8}},  # the talker may be late, on a busy computer
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
    address = f"tcp:127.0.0.1:{free_port()}"
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


def test_an_agent_that_was_halted_says_nothing_bad_when_it_goes_on(tmp_path: Path) -> None:
    processes = {"laser": {"command": SLEEPER, "start": True}}
    well = {**WELL, "running(laser)": True}
    with (
        service_double() as service,
        watching(tmp_path, service.url, processes=processes, **OBSERVED) as (halted, talker),
    ):
        talk(talker)
        eventually(lambda: well.items() <= service.holds().items(), "all well", 60)
        well_by = len(service.batches())
        halted.send_signal(signal.SIGSTOP)
        time.sleep(LONG_S)  # longer than any silence: time itself is what passes unseen
        batches = len(service.batches())
        halted.send_signal(signal.SIGCONT)
        eventually(lambda: len(service.batches()) > batches + 3, "more of it", 60)
        eventually(lambda: well.items() <= service.signs().items(), "all well", 60)
    assert said_bad(service, well_by) == set()


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
    halted, measured_ns = threading.Event(), [1]

    def answer(method: str, path: str) -> tuple[int, Any] | None:
        if not path.endswith("/board"):
            return None
        if halted.is_set():
            threading.Event().wait(LONG_S)  # it has taken the question, and says nothing
        return 200, {"time_ns": measured_ns[0], "channels": [channel]}

    with service_double() as service:
        service.answers = answer
        with agent(config(tmp_path, service.url, {}, observers=observers)):
            well = {"on(motor)": True, "ok(pack)": True}
            eventually(lambda: well.items() <= service.signs().items(), "all well", 60)
            halted.set()
            unknown = dict.fromkeys(well)
            eventually(lambda: unknown.items() <= service.signs().items(), "nothing is known", 60)
            halted.clear()
            measured_ns[0] = 2
            eventually(lambda: well.items() <= service.signs().items(), "all well again", 60)
    assert said_bad(service) == set()


def test_an_agent_that_was_halted_finds_the_board_and_the_gateway_as_they_were(tmp_path: Path) -> None:
    """Whatever it was halted in the middle of: a question, its answer, a stream of events."""
    channel = {"channel": 0, "component": "motor", "on": True, "current_a": 1.0, "voltage_v": 24.0}
    board: dict[str, Any] = {"from": "board", "lifetime_s": 60}
    observers = {
        "board": {**board, "kind": "hardware", "wiring": {"motor": {"channel": 0}}},
        "pack": {**board, "kind": "property", "source": "board:voltage(0)", "low": 20},
        "lidar_driver": {"kind": "diagnostic", "from": "medkit", "status": ["lidar_driver"]},
    }
    well = {"on(motor)": True, "ok(pack)": True, "ok(lidar_driver)": True}

    def answer(method: str, path: str) -> tuple[int, Any] | None:
        now = {"time_ns": time.time_ns(), "channels": [channel]}
        return (200, now) if path.endswith("/board") else None

    with service_double() as service, medkit_gateway() as gateway:
        service.answers = answer
        medkit = {"url": gateway.url, "poll_s": 0.2}
        file = config(tmp_path, service.url, {}, medkit=medkit, board={"rate_hz": 20}, observers=observers)
        with agent(file) as halted:
            eventually(lambda: well.items() <= service.signs().items(), "all well", 60)
            for halted_s in (LONG_S, 1.7, 0.8):
                batches = len(service.batches())
                halted.send_signal(signal.SIGSTOP)
                time.sleep(halted_s)  # time itself is what passes unseen
                halted.send_signal(signal.SIGCONT)
                eventually(lambda n=batches: len(service.batches()) > n + 3, "more of it", 60)  # type: ignore[misc]  # bound for this round
                eventually(lambda: well.items() <= service.signs().items(), "all well again", 60)
    assert said_bad(service) == set()


def test_what_a_feed_that_failed_has_fed_is_unknown() -> None:
    changes: list[Change] = []
    watch = Watch([GeneralObserver("scan", Rate(10, 8))], Clock(), changes.extend)

    class Failing:
        def __init__(self, *_: object) -> None:
            pass

        async def run(self, deliver: Deliver) -> None:
            while not changes:
                deliver("scan", None, None)
                await asyncio.sleep(0.1)
            raise ZeroDivisionError("mine")

    async def test() -> None:
        beats = asyncio.create_task(watch.run())
        await _fed(Failing(), {"scan"}, watch)
        while len(changes) < 2:
            await asyncio.sleep(0.01)
        beats.cancel()
        await asyncio.gather(beats, return_exceptions=True)

    asyncio.run(asyncio.wait_for(test(), 60))
    assert [None if change.value is None else str(change.value) for change in changes] == ["ok(scan)", None]
