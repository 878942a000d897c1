"""The agent as a real process, with real processes below it: start, stop, kill -9, the service going away."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import DEAF, SLEEPER, WRITES_PID, agent, alive, config, marked, pid_file
from tests.clients.service_double import ServiceDouble, eventually

FAMILY = (
    WRITES_PID + "import subprocess; "
    "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(1000)', sys.argv[1]]); time.sleep(1000)"
)


def python(code: str, *arguments: object) -> list[str]:
    return [sys.executable, "-c", code, *map(str, arguments)]


def runs(service: ServiceDouble, node: str) -> bool | None:
    return service.holds().get(f"running({node})")


def writing(tmp_path: Path, name: str = "pid") -> list[str]:
    """Return a program that writes its number, and goes on."""
    return python(WRITES_PID + "time.sleep(1000)", tmp_path / name)


def test_nodes_are_started_seen_to_run_killed_and_stopped_and_only_what_is_listed(
    service: ServiceDouble, tmp_path: Path
) -> None:
    family = str(tmp_path / "family")
    late = "print('...', flush=True); time.sleep(0.2); print('laser up', flush=True); time.sleep(9)"
    processes = {
        "laser": {"command": writing(tmp_path)},
        "late": {"command": python(f"import time; {late}"), "ready": {"output": "laser (up|ready)"}},
        "deaf": {"command": python(DEAF, tmp_path / "deaf"), "stop_grace_s": 0.2},
        "family": {"command": python(FAMILY, family)},
        "mute": {"command": SLEEPER, "ready": "notify", "start_timeout_s": 60},
    }
    with agent(config(tmp_path, service.url, processes)):
        eventually(lambda: runs(service, "laser") is False, "not running(laser)")
        assert "does not run" in service.do("r:1", "stop_node", "laser")["message"]
        assert service.do("r:2", "start_node", "laser")["code"] == 0
        eventually(lambda: runs(service, "laser") is True, "running(laser)")
        first = pid_file(tmp_path, "pid")
        again = service.do("r:3", "start_node", "laser")
        assert (again["code"], again["message"][:30]) == (0, "runs already: laser is process")
        for number, running in ((signal.SIGSTOP, False), (signal.SIGCONT, True), (signal.SIGKILL, False)):
            os.kill(first, number)
            eventually(lambda running=running: runs(service, "laser") is running, f"{number}")  # type: ignore[misc]  # bound for this round
        assert service.do("r:4", "start_node", "laser")["code"] == 0
        eventually(lambda: runs(service, "laser") is True, "running(laser) again")
        eventually(lambda: pid_file(tmp_path, "pid") != first, "another process")
        assert service.do("r:5", "stop_node", "laser")["code"] == 0
        eventually(lambda: runs(service, "laser") is False, "not running(laser)")
        assert not alive(pid_file(tmp_path, "pid"))

        unknown = service.do("r:6", "start_node", "rm -rf /; laser")
        assert (unknown["code"], "configured are: laser" in unknown["message"]) == (2, True)
        assert service.do("r:7", "format_disk", "laser")["code"] == 2
        assert service.do("r:8", "start_node")["code"] == 2

        assert service.do("r:9", "start_node", "late")["code"] == 0
        slow = service.do("r:10", "start_node", "mute", timeout_s=0.4)
        assert (slow["code"], "not done within 0.4 s" in slow["message"]) == (3, True)
        service.do("r:11", "start_node", "deaf")
        deaf = pid_file(tmp_path, "deaf")
        stopped = service.do("r:12", "stop_node", "deaf")
        assert (stopped["code"], "was killed" in stopped["message"], alive(deaf)) == (0, True, False)
        service.do("r:13", "start_node", "family")
        eventually(lambda: len(marked(family)) >= 2, "parent and child")
        service.do("r:14", "stop_node", "family")
        eventually(lambda: not marked(family), "neither parent nor child")
        service.do("r:15", "start_node", "family")
        eventually(lambda: len(marked(family)) >= 2, "parent and child")
        os.kill(pid_file(tmp_path, "family"), signal.SIGKILL)
        eventually(lambda: not marked(family), "what a killed node had started does not outlive it")


def reading(service: ServiceDouble, literal: str) -> dict[str, Any]:
    """Return what was measured beside the newest such literal; nothing while there is none."""
    for batch in reversed(service.batches()):
        if literal in batch["observations"] and "readings" in batch:
            return dict(batch["readings"][batch["observations"].index(literal)] or {})
    return {}


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_process_that_is_halted_does_not_run_and_can_be_stopped(
    service: ServiceDouble, tmp_path: Path, wrapped: bool
) -> None:
    """Also where a shell only waits for it. Its end is in order, and a shell's is at once."""
    ends = "import signal; signal.signal(signal.SIGTERM, lambda *_: (print('bye', flush=True), sys.exit())); "
    command = python(f"import sys; {ends}" + WRITES_PID + "time.sleep(1000)", tmp_path / "pid")
    if wrapped:
        command = ["sh", "-c", f'{sys.executable} -c "$1" "$2"; true', "sh", command[2], command[3]]
    processes = {"laser": {"command": command, "start": True, "stop_grace_s": 20}}
    with agent(config(tmp_path, service.url, processes)):
        eventually(lambda: runs(service, "laser"), "running(laser)")
        os.kill(pid_file(tmp_path, "pid"), signal.SIGSTOP)
        eventually(lambda: runs(service, "laser") is False, "not running(laser)")
        said = {"value": "stopped by a signal (SIGSTOP)", "symptom": "halted"}
        eventually(lambda: reading(service, "not running(laser)") == said, "why")
        start = service.do("r:1", "start_node", "laser")
        assert (start["code"], "halted" in start["message"]) == (0, True)
        assert service.do("r:2", "stop_node", "laser", timeout_s=30)["message"] == "laser ended"
        log = tmp_path / "state" / "logs" / "laser.log"
        eventually(lambda: wrapped or "bye" in log.read_text(), "its last word")
        said = {"value": "was stopped by the agent", "symptom": "ended"}
        eventually(lambda: reading(service, "not running(laser)") == said, "why")
        assert service.do("r:3", "start_node", "laser")["message"].startswith("laser runs after")


def test_a_process_that_ended_says_how_and_what_it_printed_last(
    service: ServiceDouble, tmp_path: Path
) -> None:
    why = {
        "exits": ("print('opening'); sys.exit('cannot open it')", "exit code 1: opening; cannot open it"),
        "killed": ("os.kill(os.getpid(), 9)", "ended by SIGKILL"),
        "prints": ("print('x' * 9000); sys.exit(3)", f"exit code 3: {'x' * 487}"),
    }
    processes = {
        name: {"command": python(f"import os, sys, time; time.sleep(0.3); {does}"), "start": True}
        for name, (does, _) in why.items()
    }
    with agent(config(tmp_path, service.url, processes)):
        for name, (_, said) in why.items():
            found = {"value": said, "symptom": "ended"}
            eventually(lambda: reading(service, f"not running({name})") == found, said)  # noqa: B023  # at once


def test_a_repeated_action_gets_its_first_result_even_from_the_next_agent(
    service: ServiceDouble, tmp_path: Path
) -> None:
    file = config(tmp_path, service.url, {"laser": {"command": SLEEPER}})
    with agent(file):
        first = service.do("r:1", "start_node", "laser")
        service.do("r:2", "stop_node", "laser")
        service.ask("r:1", "start_node", "laser")
        eventually(lambda: service.results("r:1") == 2, "the result of r:1 again")
        assert runs(service, "laser") is not True
    with agent(file):
        service.ask("r:1", "start_node", "laser")
        eventually(lambda: service.results("r:1") == 3, "the result of r:1 once more")
    bodies = [p.body for p in service.posted if p.path.endswith("/r:1/result")]
    assert bodies == [first] * 3


def test_a_start_that_is_withdrawn_is_given_up_and_a_stop_that_has_begun_is_finished(
    service: ServiceDouble, tmp_path: Path
) -> None:
    processes = {
        "never": {"command": writing(tmp_path), "ready": "notify", "start_timeout_s": 60},
        "deaf": {"command": python(DEAF, tmp_path / "deaf"), "stop_grace_s": 3.0},
    }
    with agent(config(tmp_path, service.url, processes)):
        service.ask("r:1", "start_node", "never", timeout_s=60)
        eventually((tmp_path / "pid").exists, "the process's own sign")
        service.withdrawn.add("r:1")
        eventually(lambda: service.result("r:1") is not None, "a result of r:1")
        result = service.result("r:1") or {}
        assert (result["code"], "withdrawn" in result["message"]) == (5, True)
        eventually(lambda: not alive(pid_file(tmp_path, "pid")), "the end of what it had started")
        service.do("r:2", "start_node", "deaf")
        deaf = pid_file(tmp_path, "deaf")
        service.ask("r:3", "stop_node", "deaf", timeout_s=10)
        eventually(lambda: "asked to end" in service.feedback("r:3"), "the sign that it has begun")
        service.withdrawn.add("r:3")
        eventually(lambda: service.result("r:3") is not None, "a result of r:3")
        assert service.result("r:3") == {"code": 0, "message": "deaf did not end within 3 s and was killed"}
        assert not alive(deaf)


def test_a_result_is_offered_until_the_service_takes_it(service: ServiceDouble, tmp_path: Path) -> None:
    left: list[tuple[int, Any]] = [(500, {}), (503, {}), (429, {})]
    service.answers = lambda method, path: left.pop() if left and path.endswith("/result") else None
    with agent(config(tmp_path, service.url, {"laser": {"command": SLEEPER}})):
        assert service.do("r:1", "start_node", "laser")["code"] == 0
    assert left == []


def test_a_node_that_does_not_come_up_is_ended_and_explained(service: ServiceDouble, tmp_path: Path) -> None:
    nowhere, fails = "/nowhere/at/all", "print('no laser on ttyACM0'); raise SystemExit(4)"
    notify = {"ready": "notify", "start_timeout_s": 30}
    nodes: dict[str, tuple[dict[str, Any], int, str]] = {
        "missing": ({"command": [nowhere]}, 127, f"cannot be started: {nowhere}"),
        "execs": ({"command": ["sh", "-c", f"exec {nowhere}"], **notify}, 127, "exit code 127"),
        "fails": ({"command": python(fails), **notify}, 1, "ttyACM0"),
        "mute": ({"command": SLEEPER, **notify, "start_timeout_s": 0.3}, 3, "no sign of running"),
    }
    processes = {name: process for name, (process, _, _) in nodes.items()}
    with agent(config(tmp_path, service.url, processes)):
        for name, (_, code, message) in nodes.items():
            result = service.do(f"start:{name}", "start_node", name)
            assert (result["code"], message in result["message"]) == (code, True), result
            assert runs(service, name) is not True
            assert service.do(f"stop:{name}", "stop_node", name)["code"] == 0


def test_everything_ends_with_the_agent(service: ServiceDouble, tmp_path: Path) -> None:
    mark = str(tmp_path / "family")
    with agent(
        config(tmp_path, service.url, {"laser": {"command": python(FAMILY, mark), "start": True}})
    ) as process:
        eventually(lambda: len(marked(mark)) >= 2, "parent and child")
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
        assert marked(mark) == []


def test_kill_9_of_the_agent_leaves_no_orphan(service: ServiceDouble, tmp_path: Path) -> None:
    mark, deaf = str(tmp_path / "family"), tmp_path / "deaf"
    processes = {
        "laser": {"command": python(FAMILY, mark), "start": True},
        "deaf": {"command": python(DEAF, deaf), "start": True},
        "halted": {"command": writing(tmp_path), "start": True},
    }
    with agent(config(tmp_path, service.url, processes)) as process:
        eventually(lambda: len(marked(mark)) >= 2 and marked(str(deaf)) and deaf.exists(), "all of them")
        os.kill(pid_file(tmp_path, "pid"), signal.SIGSTOP)
        process.send_signal(signal.SIGKILL)
        process.wait(60)
        eventually(lambda: not marked(str(tmp_path)), "no process of this test")


def test_what_was_to_end_with_a_killed_agent_is_started_anew_by_the_next(
    service: ServiceDouble, tmp_path: Path
) -> None:
    process = {"command": python(DEAF, tmp_path / "pid"), "stop_grace_s": 0.1, "start": True}
    file = config(tmp_path, service.url, {"laser": process})
    with agent(file) as killed:
        eventually(lambda: runs(service, "laser") is True, "running(laser)")
        before = pid_file(tmp_path, "pid")
        killed.send_signal(signal.SIGKILL)
        killed.wait(60)
    with agent(file):  # at once, while the guard still waits for the deaf one to end
        eventually(lambda: pid_file(tmp_path, "pid") != before, "another process")
        assert not alive(before)


def test_nothing_is_adopted_after_a_restart_of_the_computer(service: ServiceDouble, tmp_path: Path) -> None:
    file = config(tmp_path, service.url, {"laser": {"command": writing(tmp_path)}}, when_agent_ends="keep")
    with agent(file):
        service.do("r:1", "start_node", "laser")
        eventually((tmp_path / "pid").exists, "the process's own sign")
    before = pid_file(tmp_path, "pid")
    try:
        table = tmp_path / "state" / "processes.json"
        row = json.loads(table.read_text())["laser"]
        assert row["pid"] == before
        table.write_text(json.dumps({"laser": row | {"boot": "another"}}))
        with agent(file):  # the same pid and start time, but of another boot: somebody else's process
            eventually(lambda: runs(service, "laser") is False, "not running(laser)")
        assert alive(before)
    finally:
        os.kill(before, signal.SIGKILL)


def test_processes_that_are_kept_are_adopted_by_the_next_agent(
    service: ServiceDouble, tmp_path: Path
) -> None:
    file = config(tmp_path, service.url, {"laser": {"command": writing(tmp_path)}}, when_agent_ends="keep")
    with agent(file) as process:
        service.do("r:1", "start_node", "laser")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        process.send_signal(signal.SIGKILL)
        process.wait(60)
    first = pid_file(tmp_path, "pid")
    time.sleep(0.2)  # whatever was to end with the agent has ended
    assert alive(first)
    with agent(file):
        eventually(lambda: runs(service, "laser") is True, "running(laser), adopted")
        assert "runs already" in service.do("r:2", "start_node", "laser")["message"]
        assert service.do("r:3", "stop_node", "laser")["code"] == 0
        assert not alive(first)
        eventually(lambda: runs(service, "laser") is False, "not running(laser)")


def test_a_second_agent_with_the_same_state_directory_ends_with_3(
    service: ServiceDouble, tmp_path: Path
) -> None:
    file = config(tmp_path, service.url, {"laser": {"command": SLEEPER}})
    with agent(file):
        eventually(lambda: runs(service, "laser") is False, "a first report")
        with agent(file) as second:
            assert second.wait(60) == 3
    assert "in use by another process" in (tmp_path / "agent.log").read_text()


def test_what_happens_while_the_service_is_away_is_told_in_order_when_it_is_back(
    service: ServiceDouble, tmp_path: Path
) -> None:
    nodes = {
        name: {"command": python(WRITES_PID + "time.sleep(1000)", tmp_path / name)}
        for name in ("laser", "map")
    }
    with agent(config(tmp_path, service.url, nodes)):
        service.do("r:1", "start_node", "laser")
        service.do("r:2", "start_node", "map")
        eventually(lambda: runs(service, "map") is True, "running(map)")
        eventually(lambda: all((tmp_path / name).exists() for name in nodes), "the processes' own signs")
        service.down()
        told = len(service.batches())
        for name in ("laser", "map"):
            os.kill(pid_file(tmp_path, name), signal.SIGKILL)
            time.sleep(0.5)  # two changes, not one
        service.up()
        eventually(lambda: runs(service, "map") is False, "not running(map)")
        eventually(lambda: len(service.batches()) >= told + 3, "the replay and a heartbeat")
    replayed = service.batches()[told:]
    said = [sentence for batch in replayed for sentence in batch["observations"]]
    assert said.index("not running(laser)") < said.index("not running(map)")
    times = [batch["time"] for batch in replayed]
    assert times == sorted(times)
    assert service.repeated == 0
