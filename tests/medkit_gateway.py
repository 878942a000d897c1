"""A gateway that answers as ros2_medkit's documentation says, over real HTTP; the robot behind it is a table.

It plays lists of entities and faults, the stream of faults with ids and Last-Event-ID, the status of entities
and their transitions.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from tests.network import own_port


def fault(code: str, source: str, severity: int = 2, status: str = "CONFIRMED") -> dict[str, Any]:
    """Return a fault as lists and events have it."""
    return {
        "fault_code": code,
        "severity": severity,
        "severity_label": ("INFO", "WARN", "ERROR", "CRITICAL")[severity],
        "description": f"{code} of {source}",
        "first_occurred": 1770200000.5,
        "last_occurred": 1770200001.5,
        "occurrence_count": 3,
        "status": status,
        "reporting_sources": [source],
    }


class MedkitGateway:
    """What it is to say, and what it was asked."""

    def __init__(self) -> None:
        self.port = 0
        self.nodes: dict[str, str] = {}  # id -> the node that it is, as x-medkit says
        self.apps = ["lidar_driver", "motor_controller"]
        self.faults: list[Any] = []
        self.events: list[tuple[str, bytes]] = []  # name and data
        self.answers: dict[str, tuple[int, bytes]] = {}  # by path, instead of its own
        self.asked: list[tuple[str, str, str | None]] = []  # method, path, Last-Event-ID or token
        self.states: dict[str, list[str]] = {}  # entity -> what its status will be, the last one for good
        self.changed = threading.Condition()
        self._server: ThreadingHTTPServer | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/api/v1"

    def happens(self, kind: str, value: dict[str, Any], entity: str | None = None) -> None:
        """Stream an event."""
        event: dict[str, Any] = {"event_type": kind, "fault": value, "timestamp": 1770200002.25}
        if entity is not None:
            event["x-medkit"] = {"entity_type": "apps", "entity_id": entity}
        self.say(kind, json.dumps(event).encode())

    def say(self, kind: str, data: bytes) -> None:
        with self.changed:
            self.events.append((kind, data))
            self.changed.notify_all()

    def up(self) -> None:
        gateway = self

        class Handler(_Handler):
            medkit = gateway

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            allow_reuse_address = True

        self.port = self.port or own_port()
        self._server = Server(("127.0.0.1", self.port), Handler)
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()

    def down(self) -> None:
        if self._server is not None:
            server, self._server = self._server, None
            server.shutdown()
            server.server_close()
            with self.changed:
                self.changed.notify_all()

    @property
    def is_up(self) -> bool:
        return self._server is not None


class _Handler(BaseHTTPRequestHandler):
    medkit: MedkitGateway

    def do_GET(self) -> None:
        path = self._asked(self.headers.get("Last-Event-ID"))
        if path in self.medkit.answers:
            self._send(*self.medkit.answers[path])
        elif path == "/faults/stream":
            self._stream()
        elif path == "/faults":
            self._items(self.medkit.faults)
        elif path in ("/apps", "/components"):
            names = self.medkit.apps if path == "/apps" else ["host"]
            self._items([self._entity(path, name) for name in names])
        elif path.endswith("/status") and (states := self.medkit.states.get(path[1 : -len("/status")])):
            state = states.pop(0) if len(states) > 1 else states[0]
            self._send(200, json.dumps({"status": state, "restart": f"/api/v1{path}/restart"}).encode())
        else:
            self._send(404, b"{}")

    def _entity(self, path: str, name: str) -> dict[str, Any]:
        found: dict[str, Any] = {"id": name, "name": name, "href": f"/api/v1{path}/{name}"}
        if name in self.medkit.nodes:
            found["x-medkit"] = {"is_online": True, "ros2": {"node": self.medkit.nodes[name]}}
        return found

    def do_PUT(self) -> None:
        path = self._asked(self.headers.get("Authorization"))
        self._send(*self.medkit.answers.get(path, (202, b"")))

    def _asked(self, about: str | None) -> str:
        path = self.path.removeprefix("/api/v1")
        self.medkit.asked.append((self.command, path, about))
        return path

    def _stream(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        said = int(self.headers.get("Last-Event-ID", 0))
        medkit = self.medkit
        try:
            while medkit.is_up:
                with medkit.changed:
                    if len(medkit.events) <= said:
                        medkit.changed.wait(1)
                    new = medkit.events[said:]
                for name, data in new:
                    said += 1
                    self.wfile.write(b"id: %d\nevent: %s\ndata: %s\n\n" % (said, name.encode(), data))
                self.wfile.write(b": keepalive\n\n")
        except OSError:
            pass  # the client went away

    def _items(self, items: list[Any]) -> None:
        self._send(200, json.dumps({"items": items, "x-medkit": {"total_count": len(items)}}).encode())

    def _send(self, status: int, data: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        pass


class FreezableGateway:
    """A gateway as a process of its own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        assert process.stdout is not None
        self.url = process.stdout.readline().strip()

    def halt(self) -> None:
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        self._process.send_signal(signal.SIGCONT)


@contextmanager
def freezable_gateway() -> Iterator[FreezableGateway]:
    command = [sys.executable, "-m", __name__]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1])
    try:
        yield FreezableGateway(process)
    finally:
        process.kill()
        process.wait()


@contextmanager
def medkit_gateway() -> Iterator[MedkitGateway]:
    found = MedkitGateway()
    found.up()
    try:
        yield found
    finally:
        found.down()


if __name__ == "__main__":
    with medkit_gateway() as by_itself:
        sys.stdout.write(f"{by_itself.url}\n")
        sys.stdout.flush()
        signal.pause()
