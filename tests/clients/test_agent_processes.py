"""The agent as a real process, with real processes below it: start, stop, kill -9, the service going away."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import DEAF, SLEEPER, WRITES_PID, agent, alive, config, marked, pid_file
from tests.clients.service_double import ServiceDouble, eventually, service_double

FAMILY = (
    WRITES_PID + "import subprocess; "
    "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(1000)', sys.argv[1]]); time.sleep(1000)"
)


@pytest.fixture
def service() -> Iterator[ServiceDouble]:
    with service_double() as double:
        yield double


def python(code: str, *arguments: object) -> list[str]:
    return [sys.executable, "-c", code, *map(str, arguments)]


def runs(service: ServiceDouble, node: str) -> bool | None:
    return service.holds().get(f"running({node})")


def test_it_starts_a_node_sees_it_run_and_stops_it(service: ServiceDouble, tmp_path: Path) -> None:
    command = python(WRITES_PID + "time.sleep(1000)", tmp_path / "pid")
    with agent(config(tmp_path, service.url, {"laser": {"command": command}})):
        eventually(lambda: runs(service, "laser") is False, "not running(laser)")
        assert service.do("r:1", "start_node", "laser")["code"] == 0
        eventually(lambda: runs(service, "laser") is True, "running(laser)")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        assert alive(pid_file(tmp_path, "pid"))
        assert service.do("r:2", "stop_node", "laser")["code"] == 0
        eventually(lambda: runs(service, "laser") is False, "not running(laser)")
        assert not alive(pid_file(tmp_path, "pid"))


def test_what_is_there_already_is_not_done_again(service: ServiceDouble, tmp_path: Path) -> None:
    with agent(config(tmp_path, service.url, {"laser": {"command": SLEEPER}})):
        assert "does not run" in service.do("r:1", "stop_node", "laser")["message"]
        service.do("r:2", "start_node", "laser")
        again = service.do("r:3", "start_node", "laser")
        assert again["code"] == 0
        assert again["message"].startswith("runs already: laser is process ")


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
        eventually((tmp_path / "pid").exists, "the process's own sign")
        os.kill(pid_file(tmp_path, "pid"), signal.SIGSTOP)
        eventually(lambda: runs(service, "laser") is False, "not running(laser)")
        said = {"value": "stopped by a signal (SIGSTOP)", "symptom": "halted"}
        eventually(lambda: reading(service, "not running(laser)") == said, "why")
        start = service.do("r:1", "start_node", "laser")
        assert start["code"] == 0
        assert start["message"].startswith("runs already: laser is process ")
        assert "halted" in start["message"]
        assert service.do("r:2", "stop_node", "laser", timeout_s=30)["message"] == "laser ended"
        log = tmp_path / "state" / "logs" / "laser.log"
        eventually(lambda: wrapped or "bye" in log.read_text(), "its last word")
        said = {"value": "was stopped by the agent", "symptom": "ended"}
        eventually(lambda: reading(service, "not running(laser)") == said, "why")
        assert service.do("r:3", "start_node", "laser")["message"].startswith("laser runs after")
        eventually(lambda: runs(service, "laser"), "running(laser)")


def test_a_process_that_goes_on_runs_again(service: ServiceDouble, tmp_path: Path) -> None:
    command = python(WRITES_PID + "time.sleep(1000)", tmp_path / "pid")
    with agent(config(tmp_path, service.url, {"laser": {"command": command, "start": True}})):
        eventually(lambda: runs(service, "laser"), "running(laser)")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        for number, running in ((signal.SIGSTOP, False), (signal.SIGCONT, True)):
            os.kill(pid_file(tmp_path, "pid"), number)
            eventually(lambda running=running: runs(service, "laser") is running, f"{number}")  # type: ignore[misc]  # bound for this round


@pytest.mark.parametrize(
    ("does", "why"),
    [
        (
            "print('opening'); sys.exit('cannot open it')",
            "exit code 1: opening; cannot open it",
        ),
        ("os.kill(os.getpid(), 9)", "ended by SIGKILL"),
        ("print('x' * 9000); sys.exit(3)", f"exit code 3: {'x' * 487}"),
    ],
)
def test_a_process_that_ended_says_how_and_what_it_printed_last(
    service: ServiceDouble, tmp_path: Path, does: str, why: str
) -> None:
    command = python(f"import os, sys, time; time.sleep(0.3); {does}")
    with agent(config(tmp_path, service.url, {"laser": {"command": command, "start": True}})):
        eventually(lambda: reading(service, "not running(laser)").get("symptom") == "ended", "its end")
        eventually(lambda: reading(service, "not running(laser)") == {"value": why, "symptom": "ended"}, why)


def test_an_agent_that_is_killed_takes_along_what_is_halted(service: ServiceDouble, tmp_path: Path) -> None:
    command = python(WRITES_PID + "time.sleep(1000)", tmp_path / "pid")
    with agent(config(tmp_path, service.url, {"laser": {"command": command, "start": True}})) as process:
        eventually(lambda: runs(service, "laser"), "running(laser)")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        os.kill(pid_file(tmp_path, "pid"), signal.SIGSTOP)
        process.kill()
        eventually(lambda: not alive(pid_file(tmp_path, "pid")), "its end")


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


def test_a_start_that_the_service_withdraws_is_given_up(service: ServiceDouble, tmp_path: Path) -> None:
    command = python(WRITES_PID + "time.sleep(1000)", tmp_path / "pid")
    never_ready = {"command": command, "ready": "notify", "start_timeout_s": 60}
    with agent(config(tmp_path, service.url, {"laser": never_ready})):
        service.ask("r:1", "start_node", "laser", timeout_s=60)
        eventually((tmp_path / "pid").exists, "the process's own sign")
        service.withdrawn.add("r:1")
        eventually(lambda: service.result("r:1") is not None, "a result of r:1")
        result = service.result("r:1")
        assert result is not None
        assert result["code"] == 5
        assert "withdrawn" in result["message"]
        eventually(lambda: not alive(pid_file(tmp_path, "pid")), "the end of what it had started")


def test_a_stop_that_has_begun_is_finished_although_withdrawn(service: ServiceDouble, tmp_path: Path) -> None:
    deaf = {"command": python(DEAF, tmp_path / "pid"), "stop_grace_s": 3.0}
    with agent(config(tmp_path, service.url, {"laser": deaf})):
        service.do("r:1", "start_node", "laser")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        service.ask("r:2", "stop_node", "laser", timeout_s=10)
        eventually(lambda: "asked to end" in service.feedback("r:2"), "the sign that it has begun")
        service.withdrawn.add("r:2")
        eventually(lambda: service.result("r:2") is not None, "a result of r:2")
        assert service.result("r:2") == {"code": 0, "message": "laser did not end within 3 s and was killed"}
        assert not alive(pid_file(tmp_path, "pid"))


def test_a_result_is_offered_until_the_service_takes_it(service: ServiceDouble, tmp_path: Path) -> None:
    left: list[tuple[int, Any]] = [(500, {}), (503, {}), (429, {})]
    service.answers = lambda method, path: left.pop() if left and path.endswith("/result") else None
    with agent(config(tmp_path, service.url, {"laser": {"command": SLEEPER}})):
        assert service.do("r:1", "start_node", "laser")["code"] == 0
    assert left == []


def test_what_the_configuration_does_not_list_is_refused(service: ServiceDouble, tmp_path: Path) -> None:
    with agent(config(tmp_path, service.url, {"laser": {"command": SLEEPER}})):
        unknown = service.do("r:1", "start_node", "rm -rf /; laser")
        assert (unknown["code"], "configured are: laser" in unknown["message"]) == (2, True)
        assert service.do("r:2", "format_disk", "laser")["code"] == 2
        assert service.do("r:3", "start_node")["code"] == 2


@pytest.mark.parametrize(
    ("process", "code", "message"),
    [
        ({"command": ["/nowhere/at/all"]}, 127, "cannot be started: /nowhere/at/all"),
        ({"command": ["sh", "-c", "exec /nowhere/at/all"], "ready": "notify"}, 127, "exit code 127"),
        (
            {"command": python("print('no laser on ttyACM0'); raise SystemExit(4)"), "ready": "notify"},
            1,
            "ttyACM0",
        ),
        ({"command": SLEEPER, "ready": "notify", "start_timeout_s": 0.3}, 3, "no sign of running"),
    ],
)
def test_a_node_that_does_not_come_up_is_ended_and_explained(
    service: ServiceDouble, tmp_path: Path, process: dict[str, Any], code: int, message: str
) -> None:
    with agent(config(tmp_path, service.url, {"laser": process})):
        result = service.do("r:1", "start_node", "laser")
        assert result["code"] == code
        assert message in result["message"]
        assert runs(service, "laser") is not True
        assert service.do("r:2", "stop_node", "laser")["code"] == 0


def test_an_action_never_takes_longer_than_its_time_out(service: ServiceDouble, tmp_path: Path) -> None:
    process = {"command": SLEEPER, "ready": "notify", "start_timeout_s": 60}
    with agent(config(tmp_path, service.url, {"laser": process})):
        result = service.do("r:1", "start_node", "laser", timeout_s=0.4)
        assert (result["code"], "not done within 0.4 s" in result["message"]) == (3, True)


def test_a_node_is_ready_when_its_output_says_so(service: ServiceDouble, tmp_path: Path) -> None:
    code = (
        "import time; print('...', flush=True); time.sleep(0.2); print('laser up', flush=True); time.sleep(9)"
    )
    process = {"command": python(code), "ready": {"output": "laser (up|ready)"}}
    with agent(config(tmp_path, service.url, {"laser": process})):
        assert service.do("r:1", "start_node", "laser")["code"] == 0


def test_a_deaf_node_is_killed_after_its_grace(service: ServiceDouble, tmp_path: Path) -> None:
    process = {"command": python(DEAF, tmp_path / "pid"), "stop_grace_s": 0.2}
    with agent(config(tmp_path, service.url, {"laser": process})):
        service.do("r:1", "start_node", "laser")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        result = service.do("r:2", "stop_node", "laser")
        assert (result["code"], "was killed" in result["message"]) == (0, True)
        assert not alive(pid_file(tmp_path, "pid"))


def test_a_stop_reaches_what_the_node_started_in_turn(service: ServiceDouble, tmp_path: Path) -> None:
    mark = str(tmp_path / "family")
    with agent(config(tmp_path, service.url, {"laser": {"command": python(FAMILY, mark)}})):
        service.do("r:1", "start_node", "laser")
        eventually(lambda: len([p for p in marked(mark) if p]) >= 2, "parent and child")
        service.do("r:2", "stop_node", "laser")
        eventually(lambda: not marked(mark), "neither parent nor child")


def test_what_a_killed_node_had_started_does_not_outlive_it(service: ServiceDouble, tmp_path: Path) -> None:
    mark = str(tmp_path / "family")
    with agent(config(tmp_path, service.url, {"laser": {"command": python(FAMILY, mark)}})):
        service.do("r:1", "start_node", "laser")
        eventually(lambda: len(marked(mark)) >= 2, "parent and child")
        os.kill(pid_file(tmp_path, "family"), signal.SIGKILL)
        eventually(lambda: not marked(mark), "neither parent nor child")


def test_a_killed_node_is_reported_and_can_be_started_again(service: ServiceDouble, tmp_path: Path) -> None:
    command = python(WRITES_PID + "time.sleep(1000)", tmp_path / "pid")
    with agent(config(tmp_path, service.url, {"laser": {"command": command}})):
        service.do("r:1", "start_node", "laser")
        eventually(lambda: runs(service, "laser") is True, "running(laser)")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        os.kill(pid_file(tmp_path, "pid"), signal.SIGKILL)
        eventually(lambda: runs(service, "laser") is False, "not running(laser)")
        assert service.do("r:2", "start_node", "laser")["code"] == 0
        eventually(lambda: runs(service, "laser") is True, "running(laser) again")


def test_everything_ends_with_the_agent(service: ServiceDouble, tmp_path: Path) -> None:
    mark = str(tmp_path / "family")
    with agent(
        config(tmp_path, service.url, {"laser": {"command": python(FAMILY, mark), "start": True}})
    ) as process:
        eventually(lambda: len(marked(mark)) >= 2, "parent and child")
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
        assert marked(mark) == []


def test_kill_9_of_the_agent_leaves_no_orphan(service: ServiceDouble, tmp_path: Path) -> None:
    mark, deaf = str(tmp_path / "family"), tmp_path / "deaf"
    processes = {
        "laser": {"command": python(FAMILY, mark), "start": True},
        "deaf": {"command": python(DEAF, deaf), "start": True},
    }
    file = config(tmp_path, service.url, processes)
    with agent(file) as process:
        eventually(lambda: len(marked(mark)) >= 2 and marked(str(deaf)) and deaf.exists(), "all of them")
        process.send_signal(signal.SIGKILL)
        process.wait(20)
        eventually(lambda: not marked(str(tmp_path)), "no process of this test")
    with agent(file):  # and the state directory serves the next one
        eventually(lambda: runs(service, "laser") is True, "running(laser)")


def test_what_was_to_end_with_a_killed_agent_is_started_anew_by_the_next(
    service: ServiceDouble, tmp_path: Path
) -> None:
    process = {"command": python(DEAF, tmp_path / "pid"), "stop_grace_s": 0.1, "start": True}
    file = config(tmp_path, service.url, {"laser": process})
    with agent(file) as killed:
        eventually(lambda: runs(service, "laser") is True, "running(laser)")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        before = pid_file(tmp_path, "pid")
        killed.send_signal(signal.SIGKILL)
        killed.wait(20)
    with agent(file):  # at once, while the guard still waits for the deaf one to end
        eventually(lambda: pid_file(tmp_path, "pid") != before, "another process")
        assert not alive(before)


def test_nothing_is_adopted_after_a_restart_of_the_computer(service: ServiceDouble, tmp_path: Path) -> None:
    command = python(WRITES_PID + "time.sleep(1000)", tmp_path / "pid")
    file = config(tmp_path, service.url, {"laser": {"command": command}}, when_agent_ends="keep")
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
    command = python(WRITES_PID + "time.sleep(1000)", tmp_path / "pid")
    file = config(tmp_path, service.url, {"laser": {"command": command}}, when_agent_ends="keep")
    with agent(file) as process:
        service.do("r:1", "start_node", "laser")
        eventually((tmp_path / "pid").exists, "the process's own sign")
        process.send_signal(signal.SIGKILL)
        process.wait(20)
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
            assert second.wait(20) == 3
    assert "in use by another process" in (tmp_path / "agent.log").read_text()


def test_literals_are_said_again_before_their_lifetime_ends(service: ServiceDouble, tmp_path: Path) -> None:
    with agent(config(tmp_path, service.url, {"laser": {"command": SLEEPER}})):
        eventually(lambda: len(service.batches()) >= 4, "heartbeats")
    batches = service.batches()
    assert {(batch["source"], batch["lifetime_s"]) for batch in batches} == {("agent onboard", 2.5)}
    assert all(batch["observations"] == ["not running(laser)"] for batch in batches)


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


def test_a_wrong_configuration_ends_with_2_and_names_the_line(service: ServiceDouble, tmp_path: Path) -> None:
    file = tmp_path / "agent.yaml"
    file.write_text(
        "robot: r\nservice: {url: http://127.0.0.1:1}\nprocesses:\n  laser:\n    comand: [true]\n"
    )
    with agent(file) as process:
        assert process.wait(20) == 2
    assert (
        f"{file}:5: processes.laser.comand: is no key here; did you mean command"
        in (tmp_path / "agent.log").read_text()
    )
