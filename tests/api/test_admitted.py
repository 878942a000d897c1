"""Requests that are under way when their key is revoked end with it, whatever they wait for."""

from __future__ import annotations

import json
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from tests.api.conftest import Service, StartService
from tests.waiting import for_ever, until

from robomend.api import gate
from robomend.api.control_lane import UrgentAdmission
from robomend.security import Role
from robomend.store import Transaction, api_keys


class Keyed:
    """A service with keys, that looks whether they are good all the time."""

    def __init__(self, service: Service, admitted: threading.Event) -> None:
        self.service = service
        self.admin = {"Authorization": f"Bearer {service.key('admin')}"}
        self.operator = service.key("operator")
        self.admitted = admitted
        """Set when a request of anybody else has come through the gate."""
        service.http.headers.update(self.admin)
        service.with_robot()

    def revoke(self) -> None:
        """Revoke the keys but the admin's, when a request with one of them has come through the gate."""
        assert self.admitted.wait(60)

        def revoke(tx: Transaction) -> None:
            for key in api_keys.every(tx):
                if key.role != "admin":
                    api_keys.revoke(tx, key.id)

        self.service.run(self.service.runtime.store.write(revoke))

    def begin(self, method: str, path: str, kind: str = "application/json") -> socket.socket:
        """Return a connection on which the head of such a request was sent, and admitted."""
        connection = self.service.connect()
        head = (
            f"{method} /api/v1{path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {self.operator}\r\n"
        )
        head += f"Content-Type: {kind}\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n"
        connection.sendall(head.encode())
        assert self.admitted.wait(60)
        return connection


@pytest.fixture
def keyed(start: StartService, monkeypatch: pytest.MonkeyPatch) -> Keyed:
    for name, value_s in (
        ("body.LOOK_S", 0.0),
        ("gate.FRESH_S", 0.0),
        ("control_lane.USUAL_S", 60.0),  # what was known last does not count
    ):
        monkeypatch.setattr(f"robomend.api.{name}", value_s)
    admitted = threading.Event()

    def noting(kind: Any) -> None:
        admit = kind.admit

        async def noted(*arguments: Any, **options: Any) -> Any:
            principal = await admit(*arguments, **options)
            if principal.role is not Role.ADMIN:
                admitted.set()
            return principal

        monkeypatch.setattr(kind, "admit", noted)

    noting(gate.Admission)
    noting(UrgentAdmission)
    return Keyed(start(), admitted)


def chunk(data: bytes) -> bytes:
    """Return a piece of a body as it goes over the wire."""
    return b"%x\r\n%s\r\n" % (len(data), data)


def answer_on(connection: socket.socket) -> tuple[int, dict[str, Any]]:
    """Return status and body of the answer, after which the connection ends."""
    found = b"".join(iter(lambda: connection.recv(65536), b""))
    connection.close()
    head, _, body = found.partition(b"\r\n\r\n")
    return int(head.split()[1]), json.loads(body)


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("GET", "/robots/r1/diagnosis?wait_s=60&after=1000", None),
        ("POST", "/robots/r1/actions/next", {"agent": "a", "wait_s": 60}),
        ("GET", "/robots/r1/actions/next?wait_s=60", None),
    ],
)
def test_a_long_poll_ends_with_its_key(
    keyed: Keyed, monkeypatch: pytest.MonkeyPatch, method: str, path: str, body: Any
) -> None:
    async def nothing_to_do(*_: Any, **__: Any) -> None:
        await for_ever()

    monkeypatch.setattr(keyed.service.repairs, "orders", nothing_to_do)
    key = keyed.service.key("robot", "r1")
    with ThreadPoolExecutor(1) as clients:
        head = {"Authorization": f"Bearer {key}"}
        asked = clients.submit(keyed.service.api, method, path, json=body, headers=head, timeout=120)
        keyed.revoke()
        answer = asked.result(60)
    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")


def test_a_body_that_comes_after_its_key_was_revoked_changes_nothing(keyed: Keyed) -> None:
    connection = keyed.begin("POST", "/robots/r1/observations")
    connection.sendall(chunk(b'{"observations": '))
    keyed.revoke()
    connection.sendall(chunk(b'["not ok(scan)"]}') + chunk(b""))
    status, problem = answer_on(connection)
    assert (status, problem["code"]) == (401, "unauthorized")
    assert keyed.service.api("GET", "/robots/r1/observations").json()["revision"] == 0


def test_a_stream_of_observations_ends_with_its_key(keyed: Keyed) -> None:
    connection = keyed.begin("POST", "/robots/r1/observations", "application/x-ndjson")
    keyed.revoke()
    connection.sendall(chunk(b'{"observations": ["not ok(scan)"]}\n') + chunk(b""))
    status, problem = answer_on(connection)
    assert (status, problem["lines"]) == (401, 0)
    assert keyed.service.api("GET", "/robots/r1/observations").json()["revision"] == 0


def test_a_stop_whose_body_comes_after_its_key_was_revoked_is_none(keyed: Keyed) -> None:
    connection = keyed.begin("POST", "/stop")
    keyed.revoke()
    connection.sendall(chunk(b'{"reason": "late"}') + chunk(b""))
    assert answer_on(connection)[0] == 401
    assert not keyed.service.api("GET", "/stop").json()["active"]


def test_a_long_poll_ends_with_its_client(start: StartService) -> None:
    service = start()
    service.with_robot()
    waiting = service.runtime.robots.waiting
    with service.connect() as connection:
        connection.sendall(
            b"GET /api/v1/robots/r1/diagnosis?wait_s=60&after=9 HTTP/1.1\r\nHost: localhost\r\n\r\n"
        )
        until(lambda: waiting.requests == 1, "it waits")
    until(lambda: waiting.requests == 0, "its place is free")
