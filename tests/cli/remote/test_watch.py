"""`robomend watch`: events as lines, over lost connections."""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Queue
from typing import Any

from tests.api.test_process import command
from tests.cli.remote.conftest import Say, Shared
from tests.waiting import until
from tests.web.cable import cable

from robomend.cli.remote.watch import WORDS, told
from robomend_client.events import Event, Kind

END_S = 60.0
"""A safety net: nothing is judged by it."""


@contextmanager
def watching(*arguments: str) -> Iterator[tuple[Queue[str], list[str]]]:
    """Run the command as a process; yield its lines, and those of stderr."""
    process = subprocess.Popen(
        command("watch", *arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    lines: Queue[str] = Queue()
    said: list[str] = []

    def read() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            lines.put(line.rstrip("\n"))

    def listen() -> None:
        assert process.stderr is not None
        for line in process.stderr:
            said.append(line.rstrip("\n"))

    threads = [threading.Thread(target=each, daemon=True) for each in (read, listen)]
    for thread in threads:
        thread.start()
    try:
        yield lines, said
    finally:
        process.kill()
        process.wait(60)
        for thread in threads:
            thread.join(60)


def test_what_happens_is_told_live_and_over_a_lost_connection(shared: Shared, robot: str) -> None:
    shared.robot(robot, policy="observe")
    with cable(shared.url) as line, watching(robot, "--url", line.url) as (lines, said):
        until(lambda: said, "the stream stands")
        assert said == [f"watching {line.url}; Ctrl-C ends"]
        shared.client.observe(robot, ["not ok(scan)", "running(hokuyo_node)"])
        seen = f" {robot} seen: scan is not as it should be, hokuyo_node is running"
        while seen not in (said_first := lines.get(timeout=END_S)):
            assert "nothing has been reported yet" in said_first or "no fault" in said_first, said_first
        assert f" {robot} bad: hokuyo or hokuyo_node" in lines.get(timeout=END_S)
        assert f" {robot} is unhealthy" in lines.get(timeout=END_S)
        line.cut()
        until(lambda: len(said) == 2, "the loss is told")
        assert said[1] == f"connection lost: waiting for {line.url}"
        shared.client.observe(robot, ["ok(scan)"])
        line.mend()
        assert f" {robot} seen: scan is as it should be" in lines.get(timeout=END_S)
        assert f" {robot} no fault: " in lines.get(timeout=END_S)
        until(lambda: len(said) == 3, "that it is back is told")  # by another pipe, which may come later
        assert said[2] == "connected again"


def test_past_events_are_told_from_where_one_likes(say: Say, shared: Shared, robot: str) -> None:
    shared.robot(robot, "ok(scan)", policy="observe")
    observed: list[dict[str, Any]] = []
    count = 1
    while not observed:  # it is among those that there are, wherever the robot's health was told
        count += 1
        code, out, _ = say("watch", robot, "--after", "0", "--count", str(count), "--format", "json")
        assert code == 0
        events = [json.loads(line) for line in out.splitlines()]
        observed = [event for event in events if event["data"].get("changed")]
    assert {event["robot"] for event in events} == {robot}
    created, *_ = events
    assert (created["kind"], created["data"]["what"]) == ("robot", "created")
    assert observed[0]["data"]["changed"] == ["ok(scan)"]
    _, out, _ = say("watch", robot, "--after", str(observed[0]["id"] - 1), "--count", "1")
    assert out.endswith(f" {robot} seen: scan is as it should be\n")


def line_of(kind: Kind, robot: str | None = "r1", **data: object) -> str | None:
    line = told(Event(1, 0, kind, robot, data))
    return None if line is None else line.removeprefix("1970-01-01 00:00 ")


def action_line(**data: object) -> str | None:
    step = {"id": "r-1:0", "repair": "r-1", "name": "start_node", "parameters": ["a"], **data}
    return line_of(Kind.ACTION, "r1", **step)


def test_every_kind_of_event_has_words() -> None:
    assert WORDS.keys() == set(Kind)


def test_a_robot_that_nobody_observes_is_not_called_healthy() -> None:
    nobody = line_of(Kind.DIAGNOSIS, result={"diagnoses": [{"bad": []}]})
    assert nobody == "r1 no fault: nothing that is observed points to one"
    assert line_of(Kind.ROBOT, what="health", state="unknown", unknown=[]) == "r1 is unknown"


def test_each_kind_of_event_has_its_words() -> None:
    changed = ["not on(a)", "active(f,slow)", "inc(v)", "ok(d)"]
    assert (
        line_of(Kind.OBSERVATIONS, changed=changed)
        == "r1 seen: a has no power, f works by slow, inc(v), 1 more"
    )
    left_alone: dict[str, Any] = {"quarantine": "a", "reason": "starting a failed", "until_ns": 0}
    assert line_of(Kind.ROBOT, what="changed", **left_alone) == (
        "r1 a is left alone until 1970-01-01 00:00: starting a failed"
    )
    assert line_of(Kind.OBSERVATIONS, changed=[], forgotten=["ok(scan)"]) == "r1 unknown now: ok(scan)"
    assert line_of(Kind.OBSERVATIONS, changed=[]) is None
    assert line_of(Kind.DIAGNOSIS, result=None, fault={"detail": "too late"}) == "r1 no diagnosis: too late"
    asks = {"state": "awaiting-approval", "headline": "a has no power since 23:23:04. Power up a?"}
    waiting = line_of(Kind.REPAIR, id="r-1", **asks)
    assert waiting == "r1 repair r-1: awaiting-approval: a has no power since 23:23:04. Power up a?"
    assert action_line(state="done", message="it runs") == "r1 Start a: done: it runs"
    assert action_line(state="running") == "r1 Start a: running"
    says = {"code": 1, "message": "process 7", "time_ns": 0}
    assert action_line(state="running", feedback=says) == "r1 Start a: running: process 7"
    answered = action_line(state="running", result=0, message="it runs")
    assert answered == "r1 Start a: answered: it runs"
    assert line_of(Kind.ACTION, name="start_node", parameters=["a"], state="queued") is None
    assert line_of(Kind.BOARD, link="connected", reason="") == "r1 board: connected"
    assert line_of(Kind.BOARD, link="silent", reason="no frame") == "r1 board: silent: no frame"
    assert line_of(Kind.BOARD, channels=[]) is None
    drill = line_of(Kind.DRILL, id="d-1", state="planted", act="kill the process of a", reason="")
    assert drill == "r1 drill d-1: planted: kill the process of a"
    assert line_of(Kind.BATCH, None, batch="b-1", state="done", done=3) == "batch b-1: done"
    assert line_of(Kind.STOP, None, active=True, by="ann", reason="lunch") == "STOPPED by ann: lunch"
    assert line_of(Kind.STOP, None, active=False, by="ann") == "the stop is lifted by ann"
    assert line_of(Kind.MODEL, None, model="m") == "model m: new version"
    assert line_of(Kind.ROBOT, what="health", state="unknown", unknown=["ok(a)"]) == "r1 is unknown: ok(a)"
    assert line_of(Kind.ROBOT, what="created", etag="06f3", by="ann") == "r1 robot: created by ann"
    assert line_of(Kind.ROBOT, what="changed", by="ann", policy="auto") is not None
