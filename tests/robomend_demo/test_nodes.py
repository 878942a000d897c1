"""The generic node as a process, between a device and a bus that the test plays."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

WAIT_S = 10.0


class Line:
    """A listening socket of the test, and the connection that a node makes to it."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(WAIT_S)
        self.port = self._server.getsockname()[1]
        self.connection: socket.socket | None = None

    def accept(self) -> None:
        self.connection, _ = self._server.accept()
        self.connection.settimeout(WAIT_S)
        self._lines = self.connection.makefile("rb")

    def read(self) -> Any:
        return json.loads(self._lines.readline())

    def write(self, value: Any) -> None:
        assert self.connection is not None
        self.connection.sendall(json.dumps(value).encode() + b"\n")

    def silent(self, seconds: float = 0.3) -> bool:
        """Return whether nothing comes; afterwards only the raw connection may be read."""
        assert self.connection is not None
        self.connection.settimeout(seconds)
        try:
            return not self.connection.recv(1)
        except TimeoutError:
            return True
        finally:
            self.connection.settimeout(WAIT_S)

    def hang_up(self) -> None:
        if self.connection is not None:
            self._lines.close()
            self.connection.close()
            self.connection = None

    def close(self) -> None:
        self.hang_up()
        self._server.close()


@contextmanager
def node(
    tmp_path: Path, name: str, own: dict[str, Any], startup_s: float = 0.0, **environment: str
) -> Iterator[tuple[subprocess.Popen[bytes], Line, Line]]:
    """Run a node with a bus and a device `dev`; give the process, the bus and the device."""
    bus, device = Line(), Line()
    file = tmp_path / "nodes.json"
    config = {
        "startup_s": startup_s,
        "rate_hz": 20,
        "devices": {"dev": f"127.0.0.1:{device.port}"},
        "nodes": {name: own},
    }
    file.write_text(json.dumps(config))
    process = subprocess.Popen(
        [sys.executable, "-m", "robomend_demo.nodes", "--name", name, "--config", str(file)],
        env=os.environ | {"ROBOMEND_BUS": f"tcp:127.0.0.1:{bus.port}"} | environment,
        stdout=subprocess.PIPE,
    )
    try:
        bus.accept()
        yield process, bus, device
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()
        bus.close()
        device.close()


DRIVER = {"drives": ["dev"], "publishes": {"odom": [], "tf": []}}


def test_a_driver_publishes_each_topic_for_each_reading(tmp_path: Path) -> None:
    with node(tmp_path, "driver", DRIVER) as (_, bus, device):
        device.accept()
        for _ in range(3):
            device.write({"seq": 1})
            assert [bus.read()["topic"], bus.read()["topic"]] == ["odom", "tf"]
        assert bus.silent()


def test_a_driver_that_lost_its_device_runs_on_mute_and_never_comes_back_by_itself(tmp_path: Path) -> None:
    with node(tmp_path, "driver", DRIVER) as (process, bus, device):
        device.accept()
        device.write({"seq": 1})
        assert bus.read()["topic"] == "odom"
        device.hang_up()
        assert bus.read()["topic"] == "tf"
        assert process.stdout is not None
        assert b"mute until restarted" in process.stdout.readline()
        assert bus.silent()
        assert process.poll() is None
        device._server.settimeout(0.5)
        assert _nobody_connects(device)


def _nobody_connects(line: Line) -> bool:
    try:
        line.accept()
    except TimeoutError:
        return True
    return False


def test_a_driver_whose_device_is_off_starts_all_the_same(tmp_path: Path) -> None:
    own = {"drives": ["gone"], "publishes": {"odom": []}}
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    (tmp_path / "n.json").write_text(
        json.dumps({"devices": {"gone": f"127.0.0.1:{port}"}, "nodes": {"driver": own}})
    )
    command = [
        sys.executable,
        "-m",
        "robomend_demo.nodes",
        "--name",
        "driver",
        "--config",
        str(tmp_path / "n.json"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert b"gone" in process.stdout.readline()
        assert process.poll() is None
        process.kill()


def test_an_ordinary_node_publishes_when_its_inputs_arrive(tmp_path: Path) -> None:
    own = {"drives": [], "publishes": {"map": ["scan", "odom"], "status": ["odom"]}}
    with node(tmp_path, "mapping", own) as (_, bus, _):
        assert bus.read() == {"subscribe": ["odom", "scan"]}
        bus.write({"topic": "odom", "data": 1})
        assert bus.read()["topic"] == "status"
        bus.write({"topic": "scan", "data": 1})
        assert bus.read()["topic"] == "map"
        bus.write({"topic": "elsewhere", "data": 1})
        assert bus.silent()


def test_an_input_that_is_missing_or_old_silences_what_rests_on_it(tmp_path: Path) -> None:
    own = {"publishes": {"map": ["scan", "odom"]}}
    with node(tmp_path, "mapping", own) as (_, bus, _):
        bus.read()
        bus.write({"topic": "scan", "data": 1})
        assert bus.silent()
        bus.write({"topic": "odom", "data": 1})
        assert bus.silent(1.2)
        bus.write({"topic": "scan", "data": 1})
        assert bus.silent()


def test_a_node_without_inputs_publishes_at_its_rate(tmp_path: Path) -> None:
    with node(tmp_path, "clock", {"publishes": {"time": []}}) as (_, bus, _):
        assert [bus.read()["data"]["seq"] for _ in range(5)] == [1, 2, 3, 4, 5]


def test_a_node_comes_back_to_the_bus(tmp_path: Path) -> None:
    own = {"publishes": {"map": ["scan"]}}
    with node(tmp_path, "mapping", own) as (_, bus, _):
        bus.read()
        bus.hang_up()
        bus.accept()
        assert bus.read() == {"subscribe": ["scan"]}
        bus.write({"topic": "scan", "data": 1})
        assert bus.read()["topic"] == "map"


def test_a_source_survives_a_bus_that_goes_in_the_middle_of_its_sending(tmp_path: Path) -> None:
    with node(tmp_path, "clock", {"publishes": {"time": []}}) as (process, bus, _):
        for _ in range(3):
            bus.read()
            bus.hang_up()
            bus.accept()
        assert bus.read()["topic"] == "time"
        assert process.poll() is None


def test_it_says_that_it_is_ready_when_its_start_up_time_is_over(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notified:
        notified.bind(str(tmp_path / "notify"))
        notified.settimeout(WAIT_S)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        with node(tmp_path, "rviz", {}, startup_s=0.3, **environment) as (process, _, _):
            assert notified.recv(100) == b"READY=1"
            ticks = int(Path(f"/proc/{process.pid}/stat").read_bytes().rpartition(b")")[2].split()[19])
            uptime_s = float(Path("/proc/uptime").read_text().split()[0])
            assert uptime_s - ticks / os.sysconf("SC_CLK_TCK") >= 0.29


def test_it_imports_nothing_that_is_slow() -> None:
    slow = ("asyncio", "httpx", "yaml", "typing", "argparse", "subprocess")
    code = f"import sys, robomend_demo.nodes; print([name for name in {slow} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout == b"[]\n"


def test_a_wrong_command_line_is_explained() -> None:
    command = [sys.executable, "-m", "robomend_demo.nodes", "--name", "x"]
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode == 2
    assert b"usage" in done.stderr
