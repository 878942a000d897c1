"""`robomend-board` as a person and a script meet it."""

from __future__ import annotations

import asyncio
import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from tests.network import own_port
from tests.robomend_board.processes import END_S, Control, RawClient, running, start

from robomend.board.link import BoardLink, LinkState
from robomend_board.faults import FAULTS


def board(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "robomend_board.main", *arguments],
        capture_output=True,
        text=True,
        timeout=END_S,
        check=False,
    )


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly_with_clients_connected(number: signal.Signals, tmp_path: Path) -> None:
    with running("--state", str(tmp_path / "state")) as emulator, RawClient(emulator.port) as client:
        client.frame()
        emulator.process.send_signal(number)
        assert emulator.process.wait(END_S) == 0
        assert client.ends()


def test_every_acknowledged_switch_survives_kill_9(tmp_path: Path, long: bool) -> None:
    chance = random.Random(11)
    relays, in_doubt = [False] * 10, 0
    for _ in range(30 if long else 4):
        with running("--state", str(tmp_path / "state.json")) as emulator, RawClient(emulator.port) as client:
            client.frame()
            client.ask("02 03 00 00")
            measured = client.frame()
            found = [measured[5 + 9 * n] == 1 for n in range(10)]
            assert {n for n in range(10) if found[n] != relays[n]} <= {in_doubt}
            relays = found
            for _ in range(chance.randint(0, 12)):
                channel = chance.randrange(10)
                relays[channel] = not relays[channel]
                assert client.ask(f"02 04 02 00 {channel:02x} {relays[channel]:02x}") == "02 05 01 00 00"
            in_doubt = chance.randrange(10)
            client.send(f"02 04 02 00 {in_doubt:02x} {not relays[in_doubt]:02x}")  # it may act or not
            emulator.kill()


@pytest.mark.anyio
async def test_a_link_survives_kill_9_of_the_board_and_finds_the_relays_as_they_were(tmp_path: Path) -> None:
    state = str(tmp_path / "state.json")
    with running("--state", state, port=own_port()) as first:
        async with BoardLink("127.0.0.1", first.port, broadcast_hz=100, backoff_s=(0.02, 0.1)) as link:
            await link.switch(7, True, END_S)
            while link.snapshot.channels is None:
                await asyncio.sleep(0.005)
            first.kill()
            while link.state is LinkState.CONNECTED:
                await asyncio.sleep(0.005)
            assert link.snapshot.channels is None  # unknown, not "still on"
            second = await asyncio.to_thread(start, "--state", state, port=first.port)
            try:
                await link.wait_connected(END_S)
                snapshot = await link.request(END_S)
                assert snapshot.channels is not None
                assert [reading.on for reading in snapshot.channels] == [n == 7 for n in range(10)]
            finally:
                second.kill()
                assert second.process.stdout is not None
                second.process.stdout.close()


def test_it_ends_with_the_process_that_started_it() -> None:
    script = (
        "import subprocess, sys\n"
        "command = [sys.executable, '-m', 'robomend_board.main', '--port', '0', '--control-port', '0']\n"
        "board = subprocess.Popen([*command, '--end-with-parent'], stdout=subprocess.PIPE, text=True)\n"
        "print(board.stdout.readline(), end='', flush=True)\n"
        "sys.stdin.read()\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    with parent:
        assert parent.stdout is not None
        ready = json.loads(parent.stdout.readline())
        with Control(ready["control_port"]) as control:
            parent.send_signal(signal.SIGKILL)
            control._socket.settimeout(END_S)
            with pytest.raises(ValueError, match="Expecting value"):  # nothing: the connection was closed
                control.line()
        assert ready["pid"] != os.getpid()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--on", "10"), "0 to 9"),
        (("--on", "pc"), "no channel number"),
        (("--channels", "0"), "1<=x<=255"),
        (("--loads", "no-such-file"), "no-such-file"),
        (("--port", "70000"), "65535"),
    ],
)
def test_bad_options_end_with_2_and_say_what_is_allowed(arguments: tuple[str, ...], says: str) -> None:
    ended = board("--port", "0", "--control-port", "0", *arguments)
    assert ended.returncode == 2
    assert says in ended.stderr
    assert ended.stdout == ""


def test_a_state_file_of_something_else_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "shopping.txt"
    path.write_text("bread")
    ended = board("--port", "0", "--control-port", "0", "--state", str(path))
    assert ended.returncode == 2
    assert "remove it" in ended.stderr
    assert path.read_text() == "bread"


def test_a_port_that_is_taken_ends_with_3() -> None:
    with running() as emulator:
        ended = board("--port", str(emulator.port), "--control-port", "0")
        assert ended.returncode == 3
        assert str(emulator.port) in ended.stderr


def test_a_state_file_that_cannot_be_written_ends_with_3(tmp_path: Path) -> None:
    ended = board("--port", "0", "--control-port", "0", "--state", str(tmp_path / "missing" / "state"))
    assert ended.returncode == 3
    assert ended.stderr.endswith("missing/state: cannot be written: No such file or directory\n")


# --- the control command -------------------------------------------------------------------------------


def test_a_person_can_bring_faults_about_and_take_them_away() -> None:
    with running() as emulator:

        def control(*arguments: str) -> subprocess.CompletedProcess[str]:
            return board("control", "--port", str(emulator.control_port), *arguments)

        assert json.loads(control("fault", "stuck", "7", "at=on").stdout) == {"ok": True}
        assert json.loads(control("fault", "late", "delay_s=0.2").stdout) == {"ok": True}
        status = json.loads(control("status").stdout)
        assert status["channels"][7]["on"] is True
        assert [fault["fault"] for fault in status["faults"]] == ["stuck", "late"]
        refused = control("set", "7", "off")
        assert refused.returncode == 1
        assert "does not move" in refused.stdout
        assert control("clear", "all").returncode == 0
        assert control("set", "7", "off").returncode == 0
        assert control("fault", "stuck", "99").returncode == 1
        assert control("fault", "gremlins").returncode == 2
        assert control("fault", "late", "delay_s").returncode != 0


def test_a_person_can_watch() -> None:
    with running("--on", "2") as emulator:
        command = [sys.executable, "-m", "robomend_board.main"]
        watcher = subprocess.Popen(
            [*command, "control", "--port", str(emulator.control_port), "watch"],
            stdout=subprocess.PIPE,
            text=True,
        )
        with watcher:
            assert watcher.stdout is not None
            assert json.loads(watcher.stdout.readline())["watching"]
            first = [json.loads(watcher.stdout.readline()) for _ in range(10)]
            assert [line["on"] for line in first] == [n == 2 for n in range(10)]
            with Control(emulator.control_port) as control:
                control.ask(set={"channel": 2, "on": False})
            assert json.loads(watcher.stdout.readline())["channel"] == 2
            watcher.kill()


def test_without_an_emulator_the_control_command_ends_with_3() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        ended = board("control", "--port", str(probe.getsockname()[1]), "status")
    assert ended.returncode == 3
    assert "no emulator answers" in ended.stderr


def test_the_manual_has_every_fault_and_option() -> None:
    manual = (Path(__file__).parents[2] / "docs" / "board.md").read_text(encoding="utf-8")
    options = set(re.findall(r"--[a-z-]+", board("--help").stdout)) - {"--help"}
    assert "--control-port" in options
    missing = [word for word in (*options, *FAULTS) if f"`{word}" not in manual]
    assert missing == []
