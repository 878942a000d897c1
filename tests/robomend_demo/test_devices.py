"""The simulated devices as a process: ports that exist only while there is power."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.clients.service_double import eventually

Address = tuple[str, int]
READY = "ready.json"
"""What the devices said when they were ready."""


class ControlPort:
    """The board emulator's control port as devices see it. The real one is in test_robot.py."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._connection: socket.socket | None = None
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            connection.recv(1000)
            connection.sendall(b'{"ok": true, "watching": true}\n')
            self._connection = connection

    def power(self, channel: int, powered: bool) -> None:
        eventually(lambda: self._connection is not None, "devices that watch")
        assert self._connection is not None
        line = {"channel": channel, "on": powered, "powered": powered, "time_ns": 1}
        self._connection.sendall(json.dumps(line).encode() + b"\n")

    def drop(self) -> None:
        assert self._connection is not None
        self._connection.close()
        self._connection = None

    def close(self) -> None:
        self._server.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts; close alone does not
        self._server.close()
        self._accepting.join(5)
        if self._connection is not None:
            self._connection.close()


@contextmanager
def devices(
    tmp_path: Path, config: dict[str, Any], control: str | None = None, *more: str
) -> Iterator[tuple[subprocess.Popen[bytes], dict[str, Address]]]:
    """Run devices.py; give the process and the address of each device."""
    file = tmp_path / "devices.json"
    file.write_text(json.dumps(config))
    command = [sys.executable, "-m", "robomend_demo.devices", "--config", str(file), *more]
    if control:
        command += ["--control", control]
    with (tmp_path / "devices.log").open("ab") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log)
    assert process.stdout is not None
    try:
        (tmp_path / READY).write_bytes(process.stdout.readline())
        ready = json.loads((tmp_path / READY).read_bytes())
        found = {name: (host, int(port)) for name, (host, _, port) in _parts(ready["devices"]).items()}
        yield process, found
    finally:
        process.terminate()
        process.wait(20)
        process.stdout.close()


def _parts(addresses: dict[str, str]) -> dict[str, tuple[str, str, str]]:
    return {name: address.rpartition(":") for name, address in addresses.items()}


@pytest.fixture
def control() -> Iterator[ControlPort]:
    port = ControlPort()
    yield port
    port.close()


def reachable(address: Address) -> bool:
    try:
        socket.create_connection(address, timeout=1).close()
    except OSError:
        return False
    return True


def readings(connection: socket.socket, count: int) -> list[dict[str, Any]]:
    with connection.makefile("rb") as file:
        return [json.loads(file.readline()) for _ in range(count)]


JAGUAR = {"rate_hz": 50, "devices": {"jaguar": {"channel": 7}, "imu": {"channel": None}}}


def test_a_device_without_a_channel_is_always_there(tmp_path: Path) -> None:
    with devices(tmp_path, JAGUAR) as (_, addresses), socket.create_connection(addresses["imu"]) as imu:
        got = readings(imu, 5)
        assert [reading["seq"] for reading in got] == list(range(got[0]["seq"], got[0]["seq"] + 5))
        assert {reading["device"] for reading in got} == {"imu"}
        assert not reachable(addresses["jaguar"])


def test_a_device_is_there_while_its_channel_has_power_and_keeps_its_port(
    tmp_path: Path, control: ControlPort
) -> None:
    with devices(tmp_path, JAGUAR, control.address) as (_, addresses):
        for _ in range(3):
            assert not reachable(addresses["jaguar"])
            control.power(7, True)
            eventually(lambda: reachable(addresses["jaguar"]), "the jaguar, on")
            with socket.create_connection(addresses["jaguar"]) as jaguar:
                readings(jaguar, 2)
                control.power(7, False)
                eventually(lambda: not reachable(addresses["jaguar"]), "the jaguar, off")
                assert _ended(jaguar)


def _ended(connection: socket.socket, most_bytes: int = 100_000) -> bool:
    """Return whether the other side has ended the connection, after what it sent before."""
    connection.settimeout(5)
    read = 0
    try:
        while read < most_bytes and (data := connection.recv(65536)):
            read += len(data)
    except ConnectionResetError:
        return True
    return read < most_bytes


def test_another_channel_changes_nothing(tmp_path: Path, control: ControlPort) -> None:
    with devices(tmp_path, JAGUAR, control.address) as (_, addresses):
        control.power(3, True)
        control.power(7, True)
        eventually(lambda: reachable(addresses["jaguar"]), "the jaguar, on")
        with socket.create_connection(addresses["jaguar"]) as jaguar:
            control.power(3, False)
            readings(jaguar, 10)


def test_the_control_port_is_not_the_power(tmp_path: Path, control: ControlPort) -> None:
    with devices(tmp_path, JAGUAR, control.address) as (_, addresses):
        control.power(7, True)
        eventually(lambda: reachable(addresses["jaguar"]), "the jaguar, on")
        control.drop()
        with socket.create_connection(addresses["jaguar"]) as jaguar:
            readings(jaguar, 10)
        control.power(7, False)  # over a new connection, which the devices looked for
        eventually(lambda: not reachable(addresses["jaguar"]), "the jaguar, off")


def test_a_driver_that_does_not_read_is_cut_off_and_others_are_served(tmp_path: Path) -> None:
    fast = {"rate_hz": 5000, "devices": {"imu": {}}}
    with devices(tmp_path, fast) as (_, addresses):
        deaf = socket.socket()
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        deaf.connect(addresses["imu"])
        with socket.create_connection(addresses["imu"]) as reader:
            got = readings(reader, 12_000)
        assert got[-1]["seq"] - got[0]["seq"] == 11_999
        assert _ended(deaf, most_bytes=500_000)
        deaf.close()


def plant(tmp_path: Path, device: str, fault: str) -> dict[str, Any]:
    """Ask the fault port."""
    return ask_for_fault(tmp_path, json.dumps({"device": device, "fault": fault}))


def ask_for_fault(tmp_path: Path, line: str) -> dict[str, Any]:
    port = json.loads((tmp_path / READY).read_bytes())["fault_port"]
    with socket.create_connection(("127.0.0.1", port), timeout=10) as connection:
        connection.sendall(line.encode() + b"\n")
        answer: dict[str, Any] = json.loads(connection.makefile().readline())
    return answer


def silent(address: Address) -> bool:
    """Return whether a device takes a connection and says nothing for ten of its periods."""
    with socket.create_connection(address, timeout=0.2) as connection:
        try:
            return not connection.recv(1)
        except TimeoutError:
            return True


def test_a_hung_device_is_silent_until_it_lost_its_power_once(tmp_path: Path, control: ControlPort) -> None:
    with devices(tmp_path, JAGUAR, control.address) as (_, addresses):
        control.power(7, True)
        eventually(lambda: reachable(addresses["jaguar"]), "the jaguar, on")
        with socket.create_connection(addresses["jaguar"]) as before:
            readings(before, 2)
            assert plant(tmp_path, "jaguar", "hung") == {"ok": True}
            assert silent(addresses["jaguar"])
            with socket.create_connection(addresses["imu"]) as other:
                readings(other, 2)
            control.power(7, False)
            assert _ended(before)
        control.power(7, True)
        eventually(lambda: reachable(addresses["jaguar"]), "the jaguar, on again")
        with socket.create_connection(addresses["jaguar"]) as after:
            readings(after, 2)


def test_a_dead_device_stays_silent_until_its_fault_is_lifted(tmp_path: Path, control: ControlPort) -> None:
    with devices(tmp_path, JAGUAR, control.address) as (_, addresses):
        assert plant(tmp_path, "jaguar", "dead") == {"ok": True}
        for _ in range(2):
            control.power(7, True)
            eventually(lambda: reachable(addresses["jaguar"]), "the jaguar, on")
            assert silent(addresses["jaguar"])
            control.power(7, False)
            eventually(lambda: not reachable(addresses["jaguar"]), "the jaguar, off")
        control.power(7, True)
        eventually(lambda: reachable(addresses["jaguar"]), "the jaguar, on")
        assert plant(tmp_path, "jaguar", "none") == {"ok": True}
        with socket.create_connection(addresses["jaguar"]) as alive:
            readings(alive, 2)


def test_a_fault_that_makes_no_sense_is_refused_in_words(tmp_path: Path) -> None:
    with devices(tmp_path, JAGUAR):
        assert plant(tmp_path, "sonar", "hung") == {"ok": False, "error": "KeyError: 'sonar'"}
        assert "is not a valid DeviceFault" in plant(tmp_path, "imu", "odd")["error"]
        for line in ("[]", "{", "\xff"):
            assert ask_for_fault(tmp_path, line)["ok"] is False
        assert plant(tmp_path, "imu", "none") == {"ok": True}


def test_it_can_end_with_whoever_started_it(tmp_path: Path) -> None:
    (tmp_path / "d.json").write_text(json.dumps({"devices": {"imu": {}}}))
    command = [
        sys.executable,
        "-m",
        "robomend_demo.devices",
        "--config",
        str(tmp_path / "d.json"),
        "--end-with-parent",
    ]
    starter = "import subprocess, sys, time; subprocess.Popen(sys.argv[1:]); time.sleep(100)"
    with subprocess.Popen([sys.executable, "-c", starter, *command], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        pid = json.loads(parent.stdout.readline())["pid"]
        parent.send_signal(signal.SIGKILL)
        eventually(lambda: not Path(f"/proc/{pid}").exists() or _zombie(pid), "the end of the devices")


def _zombie(pid: int) -> bool:
    try:
        return b") Z" in Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return True


def test_sigterm_ends_it_in_order(tmp_path: Path) -> None:
    with devices(tmp_path, JAGUAR) as (process, addresses):
        with socket.create_connection(addresses["imu"]):
            os.kill(process.pid, signal.SIGTERM)
            assert process.wait(20) == 0
        assert not reachable(addresses["imu"])
