"""A whole agent, with its observers, its bus, and a service played by a double."""

from __future__ import annotations

import json
import re
import shutil
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from tests.clients.running_agent import SLEEPER, agent, config
from tests.clients.service_double import ServiceDouble, eventually
from tests.clients.talker import watching
from tests.network import own_port

from robomend_client.bus import parse_address

MANUAL = (Path(__file__).parents[2] / "docs" / "agent.md").read_text()


def said(service: ServiceDouble, sentence: str) -> list[dict[str, Any]]:
    """Return the batches that say so."""
    return [batch for batch in service.batches() if sentence in batch["observations"]]


def test_a_topic_that_falls_silent_is_told_with_its_evidence(service: ServiceDouble, tmp_path: Path) -> None:
    with watching(tmp_path, service.url, topics={"scan": {}}) as (_, talker):

        def silent(after_ns: int) -> list[dict[str, Any]]:
            """Return the batches that say it of the time after that."""
            return [batch for batch in said(service, "not ok(scan)") if batch["since"][0] >= after_ns]

        while True:  # on a busy computer the talker may be late before it, or the agent while it waits
            talker.say("scan")
            eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
            last_ns = talker.hush("scan")
            eventually(lambda: silent(last_ns), "not ok(scan)")  # noqa: B023  # at once
            first = silent(last_ns)[0]
            (since_ns,), (onset_ns,) = first["since"], first.get("onset", [0])
            if onset_ns >= last_ns:
                break
        assert first["time"] - since_ns == 350_000_000
        assert onset_ns <= since_ns
        # A heartbeat says it again, with evidence that moves on; the onset stays.
        eventually(lambda: silent(since_ns + 1), "young evidence")
        assert silent(since_ns + 1)[0]["onset"] == [onset_ns]


def test_values_and_fields_reach_observers_and_what_nobody_sees_or_fails_is_unknown(
    service: ServiceDouble, tmp_path: Path
) -> None:
    (tmp_path / "checks.py").write_text(
        "def cool(value: float) -> bool:\n    return value < 60\n"
        "def bad(value: float) -> bool:\n    return 1 / (value - 1) > 0\n"
    )
    observers = {
        "temperature": {"kind": "property", "source": "motor:temperature", "high": 60, "lifetime_s": 0.5},
        "motor": {"kind": "checks.py:cool", "source": "motor:temperature"},
        "x": {"kind": "qualitative", "source": "odom:pose.x", "window_s": 0.5},
        "bad": {"kind": "checks.py:bad", "source": "odom:pose.x"},
        "hokuyo": {"kind": "diagnostic", "status": ["hokuyo: *"]},
        "host": {"kind": "property", "source": "host:Mem", "high": 1},
        "ok(Mem,node)": {"kind": "property", "source": "processes:Mem(node)", "high": 0.9},
        "range": {"kind": "property", "source": "scan:range", "low": 0.1, "atom": "ok(scan)"},
    }
    processes = {"node": {"command": SLEEPER, "start": True}}
    topics = {"scan": {"tolerance_hz": 8, "silence_s": 10}}
    sections: dict[str, Any] = {"observers": observers, "processes": processes, "topics": topics}
    with watching(tmp_path, service.url, **sections) as (_, talker):
        talker.say("motor", data={"temperature": 70.0})
        talker.say("odom", fields={"pose.x": 2})
        talker.say("diagnostics", data=[{"name": "hokuyo: connection", "level": 2}])
        talker.say("scan", data={"range": 1.0})
        expected = {
            "ok(temperature)": False, "ok(motor)": False, "const(x)": True, "inc(x)": False, "ok(hokuyo)":
            False, "ok(host)": True, "ok(Mem,node)": True, "running(node)": True, "ok(bad)": True,
            "ok(scan)": True,
        }  # fmt: skip
        eventually(lambda: expected.items() <= service.holds().items(), f"{expected}")
        talker.say("scan", data={"range": 0.0})  # of two observers of one atom bad news wins
        eventually(lambda: service.holds().get("ok(scan)") is False, "not ok(scan)")
        talker.hush("motor")
        eventually(lambda: service.signs().get("ok(temperature)", True) is None, "nobody can see it any more")
        talker.say("odom", fields={"pose.x": 1})
        eventually(lambda: service.signs().get("ok(bad)", True) is None, "its observer raises")
        talker.say("odom", fields={"pose.x": 2})
        eventually(lambda: service.signs().get("ok(bad)") is True, "it has come to its senses")
    log = (tmp_path / "agent.log").read_text()
    assert len(re.findall(r"failed: ZeroDivisionError.*checks\.py:4", log)) == 1


def test_the_poll_says_what_the_agent_can_do_and_sees_and_observers_judge_anew_when_it_is_asked_for(
    service: ServiceDouble, tmp_path: Path
) -> None:
    actions = {"home": {"kind": "process", "command": ["true"]}}
    processes = {"laser": {"command": SLEEPER, "start": True}}
    bus_topics: dict[str, Any] = {"scan": {}, "odom": {}}
    sections: dict[str, Any] = {"topics": bus_topics, "processes": processes, "actions": actions}
    with watching(tmp_path, service.url, **sections) as (_, talker):
        eventually(lambda: service.polls, "a poll")
        poll = service.polls[0]
        drilled = [f"{name}_fault:{what}" for name in ("plant", "undo") for what in ("laser", "scan", "odom")]
        own = ["start_node:laser", "stop_node:laser"]
        assert sorted(poll["can"]) == sorted([*own, *drilled, "home"])
        delays_s = {"ok(scan)": 0.4, "ok(odom)": 0.4, "running(laser)": 0.1}
        assert {entry["atom"]: entry["detection_s"] for entry in poll["observes"]} == delays_s
        assert poll["settled"] is None
        assert service.do("r:1", "home")["code"] == 0
        talker.say("scan")
        talker.say("odom")
        eventually(lambda: delays_s.keys() <= service.holds().keys(), "all")
        asked_ns = time.time_ns()
        service.settle = {"n": 7, "atoms": ["ok(scan)", "running(laser)", "ok(elsewhere)"]}
        eventually(lambda: service.polls[-1].get("settled") == 7, "a poll that says that it was heard")

        def answers() -> list[dict[str, Any]]:
            return [batch for batch in service.batches() if batch.get("settled") == 7]

        def spoken_of() -> set[str]:  # of either sign, or unknown: on a busy computer a topic may be late
            said = {text.removeprefix("not ") for batch in answers() for text in batch["observations"]}
            return said.union(*(batch.get("unknown", ()) for batch in answers()))

        eventually(lambda: spoken_of() == {"ok(scan)", "running(laser)"}, "both, with the number")
        assert all(since_ns >= asked_ns for batch in answers() for since_ns in batch.get("since", ()))


def test_what_a_process_prints_is_kept_in_a_file_with_a_bound(service: ServiceDouble, tmp_path: Path) -> None:
    chatty = "while True: print('x' * 99)"
    processes = {
        "chatty": {"command": ["python3", "-c", chatty], "start": True, "log_mb": 0.01},
        "quiet": {"command": SLEEPER, "start": True, "log_mb": 0},
    }
    logs = tmp_path / "state" / "logs"
    with watching(tmp_path, service.url, processes=processes):
        eventually(lambda: (logs / "chatty.log.1").exists(), "a second file")
        eventually(lambda: {file.name for file in logs.iterdir()} == {"chatty.log", "chatty.log.1"}, "both")
    assert sum(file.stat().st_size for file in logs.iterdir()) <= 10486


@pytest.mark.parametrize("ends", ["stop", "keep"])
def test_the_output_of_each_start_is_kept(service: ServiceDouble, tmp_path: Path, ends: str) -> None:
    hello = "import os, time; print('hello from', os.getpid(), flush=True); time.sleep(1000)"
    processes = {"node": {"command": ["python3", "-c", hello], "start": True, "ready": {"output": "hello"}}}
    log = tmp_path / "state" / "logs" / "node.log"
    with watching(tmp_path, service.url, processes=processes, when_agent_ends=ends):
        eventually(lambda: service.holds().get("running(node)"), "the evidence in its output")
        assert service.do("r:1", "stop_node", "node")["code"] == 0
        assert service.do("r:2", "start_node", "node")["code"] == 0
        text = log.read_text()
        assert (text.count("--- started by robomend-agent"), text.count("hello from")) == (2, 2)
        assert service.do("r:3", "stop_node", "node")["code"] == 0


# --- from any language ------------------------------------------------------------------------------------


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", MANUAL, re.DOTALL)


@pytest.mark.parametrize("language", ["bash", "c"])
def test_any_language_can_publish_in_ten_lines(service: ServiceDouble, tmp_path: Path, language: str) -> None:
    (code,) = blocks(language)
    assert len(code.splitlines()) <= 11
    port = own_port()
    code = code.replace("7411", str(port))
    if language == "bash":
        command = ["bash", "-c", code]
    else:
        compiler = shutil.which("cc")
        if compiler is None:
            pytest.skip("no C compiler here")
        (tmp_path / "talk.c").write_text(code)
        subprocess.run([compiler, "-o", str(tmp_path / "talk"), str(tmp_path / "talk.c")], check=True)
        command = [str(tmp_path / "talk")]
    scan = {"tolerance_hz": 8}  # a shell that starts `sleep` ten times a second is late on a busy computer
    file = config(tmp_path, service.url, {}, bus={"listen": f"tcp:127.0.0.1:{port}"}, topics={"scan": scan})
    with agent(file):
        eventually(lambda: service.polls, "an agent")
        talker = subprocess.Popen(command)
        try:
            eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
        finally:
            talker.kill()
            talker.wait()


def test_the_lines_of_the_manual_are_lines_of_the_bus(service: ServiceDouble, tmp_path: Path) -> None:
    lines = re.findall(r"^    (\{\"(?:topic|subscribe)\".*?\})(?:  |$)", MANUAL, re.MULTILINE)
    assert len(lines) == 4
    observers = {
        "x": {"kind": "property", "source": "odom:x", "high": 1},
        "z": {"kind": "property", "source": "odom:twist.twist.angular.z", "high": 1},
    }
    with watching(tmp_path, service.url, observers=observers) as (_, talker):
        eventually(lambda: service.polls, "an agent")
        where = parse_address(talker._address)
        assert isinstance(where, tuple)
        with socket.create_connection(where) as connection:

            def heard() -> bool:
                """Send them, again if need be: an agent that was late leaves out what is from before that."""
                for line in lines:
                    now = re.sub(r"\"time\": \d+", f'"time": {time.time_ns()}', line)
                    connection.sendall(json.dumps(json.loads(now)).encode() + b"\n")
                return {"ok(x)", "ok(z)"} <= service.holds().keys()

            eventually(heard, "both fields")
            talker.say("scan", data=1)
            assert json.loads(connection.recv(4096).split(b"\n")[0])["topic"] == "scan"
