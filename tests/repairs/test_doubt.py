"""An action that must not be sent twice, cut off or unanswered: a person is asked before it is repeated.

kill -9 in the middle of one is in test_crash.py.
"""

from __future__ import annotations

import asyncio
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.remote import awaits, ended, latest, remote_robot, services
from tests.repairs.robot import CONFIG, Robot, robot_of, robot_on, service, the_repair, with_recalibrate
from tests.waiting import for_ever

pytestmark = pytest.mark.anyio

TIMEOUT_S = 3.0
"""In which the robot has begun, on however busy a machine: what nobody has taken in time is no question."""

LOOK = "and must not be done twice: look at the robot, then approve to go on or cancel"


@dataclass
class AtIt:
    """A robot's habit of beginning to recalibrate and not ending it, until it is `freed`."""

    begun: asyncio.Event = field(default_factory=asyncio.Event)
    freed: asyncio.Event = field(default_factory=asyncio.Event)

    async def __call__(self, robot: Robot, action: str, parameter: str) -> int | None:
        if action != "recalibrate":
            return None
        if self.freed.is_set():
            robot.broken_topics.clear()
            return None
        self.begun.set()
        await self.freed.wait()
        return 1


async def test_cancelled_under_way_it_is_asked_about_before_anything_is_planned_again(tmp_path: Path) -> None:
    habit = AtIt()
    settings = ("--data", str(tmp_path))
    async with services(settings) as running, remote_robot(running, **with_recalibrate(30.0)) as robot:
        robot.spoil = habit
        await robot.settled()
        robot.broken_topics.add("odom")
        await habit.begun.wait()
        client = running[0].client
        assert client is not None
        under_way = await latest(running, lambda repair: repair["state"] == "running")
        await client.cancel(under_way["id"], "I see smoke")
        cancelled = await latest(running, ended)
        assert (cancelled["id"], cancelled["state"], cancelled["reason"]) == (
            under_way["id"],
            "cancelled",
            "I see smoke; recalibrate(base_node) was under way: "
            "nothing else is sent before a person has looked",
        )
        await running[0].kill()  # the question is on disk
        await running[0].start()
        robot.cut("lidar")  # another diagnosis, for which a repair begins by itself
        asked = await latest(running, awaits)
        assert asked["reason"] == f"recalibrate(base_node) was cut off (I see smoke), {LOOK}"
        assert len(robot.ids) == 1
        habit.freed.set()
        client = running[0].client
        assert client is not None
        await client.approve(asked["id"], "it did nothing")
        repair = await latest(running, ended)
    assert (repair["id"], repair["state"]) == (asked["id"], "repaired")
    assert robot.done.count("recalibrate(base_node)") == 2  # sent again, as somebody looked


async def test_a_stop_that_cuts_off_a_webhook_leaves_the_question(tmp_path: Path) -> None:
    called, answer = threading.Event(), threading.Event()
    calls: list[str] = []

    class Receiver(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            calls.append(self.headers["Idempotency-Key"])
            called.set()
            answer.wait(30)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Receiver)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}/"
    hook = {"kind": "webhook", "options": {"url": url, "secret": "s"}}
    config = with_recalibrate(30.0)
    config["actions"]["recalibrate"]["executor"] = hook
    try:
        async with (
            service(tmp_path, webhook_hosts=(f"127.0.0.1:{server.server_port}",)) as runtime,
            robot_on(runtime, **config) as robot,
        ):
            await robot.settled()
            robot.broken_topics.add("odom")
            assert await asyncio.to_thread(called.wait, 60)
            await runtime.repairs.stop(by="ann", reason="people on the floor")
            stopped = await the_repair(runtime)
            assert stopped["rounds"][-1]["ending"] == "halted"
            await runtime.repairs.resume(by="ann", reason="all clear")
            asked = await the_repair(runtime, ended=False)
    finally:
        answer.set()
        server.shutdown()
        server.server_close()
    assert asked["id"] != stopped["id"]
    assert asked["reason"] == f"recalibrate(base_node) was cut off (global stop: people on the floor), {LOOK}"
    assert len(calls) == 1


async def test_no_answer_is_asked_about_although_the_service_is_killed_while_others_finish(
    tmp_path: Path,
) -> None:
    async def hangs(robot: Robot, name: str, parameter: str) -> int | None:
        await for_ever()
        return None

    config = with_recalibrate(TIMEOUT_S)
    config["actions"]["start_node"] = {**CONFIG["actions"]["start_node"], "timeout_s": 2 * TIMEOUT_S}
    settings = ("--data", str(tmp_path))

    def gave_up(repair: dict[str, Any]) -> bool:
        return any((s["name"], s["state"]) == ("recalibrate", "failed") for s in repair["plan"])

    async with services(settings) as running, remote_robot(running, **config) as robot:
        robot.spoil = hangs
        await robot.settled()
        robot.silent = True  # both faults in one report
        robot.broken_topics.add("odom")
        robot.running["mapping"] = False
        robot.silent = False
        under_way = await latest(running, gave_up)
        assert under_way["state"] == "running"  # the other step is let finish
        await running[0].kill()
        await running[0].start()
        robot.spoil = None
        asked = await latest(running, awaits)
    assert "recalibrate(base_node)" in asked["reason"]
    assert "must not be done twice" in asked["reason"]


async def test_what_must_not_be_repeated_stays_a_question_whatever_the_diagnosis_or_a_stop_says(
    tmp_path: Path,
) -> None:
    given_up = asyncio.Event()

    async def without_an_answer(robot: Robot, name: str, parameter: str) -> int | None:
        await given_up.wait()
        return None

    async with robot_of(tmp_path, **with_recalibrate(TIMEOUT_S)) as (runtime, robot):
        robot.spoil = without_an_answer
        robot.broken_topics.add("odom")
        asked = await the_repair(runtime, ended=False)
        assert asked["reason"] == (
            "recalibrate(base_node) was sent, and its outcome is unknown: the robot's agent took it and "
            f"did not report in {TIMEOUT_S:g} s; it must not be sent twice: "
            "look at the robot, then approve to go on or cancel"
        )
        given_up.set()  # it is done after all, and too late
        robot.cut("lidar")  # another diagnosis: no reason to begin anew
        await asyncio.sleep(0.7)  # time in which another could begin
        assert (await the_repair(runtime, ended=False))["id"] == asked["id"]
        await runtime.repairs.stop(by="ann", reason="careful")
        stopped = await the_repair(runtime)
        assert (stopped["id"], stopped["state"]) == (asked["id"], "cancelled")
        await runtime.repairs.resume(by="ann", reason="")
        again = await the_repair(runtime, ended=False)
        assert again["id"] != asked["id"]
        assert again["reason"] == asked["reason"]
        assert len(robot.ids) == 1
        robot.spoil = None
        robot.broken_topics.clear()  # a person looked, and it had worked
        await runtime.repairs.approve(again["id"], by="ann", reason="it did work")
        repair = await the_repair(runtime)
    assert (repair["id"], repair["state"]) == (again["id"], "repaired")
    assert robot.done.count("recalibrate(base_node)") == 1
