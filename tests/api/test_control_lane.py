"""Stop, health and readiness answer whatever else goes on: the loop is held, or writes hang."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from structlog.testing import capture_logs
from tests.api.conftest import Service, StartService
from tests.waiting import until

from robomend.api import control_lane, store_probe
from robomend.api.routers import operation
from robomend.errors import StoreFull
from robomend.store import Transaction


@contextmanager
def held_loop(service: Service) -> Iterator[None]:
    """Hold the service's event loop from within, as a bug would."""
    release, held = threading.Event(), threading.Event()

    def hold() -> None:
        held.set()
        release.wait(30)

    service.loop.call_soon_threadsafe(hold)
    assert held.wait(10)
    try:
        yield
    finally:
        release.set()


@contextmanager
def hanging_writes(service: Service) -> Iterator[None]:
    """Keep the store's writer busy: what is queued behind it waits."""
    release, hung = threading.Event(), threading.Event()

    def hang(_: Transaction) -> None:
        hung.set()
        release.wait(30)

    async def begin() -> Any:
        return service.loop.create_task(service.runtime.store.write(hang))

    writing = service.run(begin())
    assert hung.wait(10)
    try:
        yield
    finally:
        release.set()
        until(writing.done, "the write did not end")


def test_a_service_that_cannot_write_is_not_ready_while_its_loop_is_held_either(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(operation, "QUEUE_AGE_S", 0.1)
    with hanging_writes(service):
        until(lambda: service.runtime.store.figures().oldest_write_s > 0.1, "nothing waits")
        with held_loop(service):
            unready = fresh(service, "GET", "/readyz")
    assert (unready.status_code, unready.json()["checks"]["queue"]["ok"]) == (503, False)
    until(lambda: fresh(service, "GET", "/readyz").status_code == 200, "not ready")


def fresh(service: Service, method: str, path: str, **options: Any) -> httpx.Response:
    """Ask on a connection of its own."""
    return httpx.request(method, f"{service.url}{path}", timeout=20, **options)


def test_they_answer_while_the_event_loop_is_held(service: Service) -> None:
    with held_loop(service):
        stopped = fresh(service, "POST", "/api/v1/stop", json={"reason": "smoke"})
        assert (stopped.status_code, stopped.json()["active"], stopped.json()["written"]) == (
            202,
            True,
            False,
        )
        assert "in force on this instance" in stopped.json()["detail"]
        assert service.runtime.repairs.switch.active
        assert fresh(service, "GET", "/api/v1/stop").json()["reason"] == "smoke"
        assert fresh(service, "GET", "/healthz").status_code == 200
        checks = fresh(service, "GET", "/readyz").json()["checks"]
        assert checks.keys() == {"store", "queue", "loop", "workers"}  # what is known without the loop
    until(lambda: bool(fresh(service, "GET", "/api/v1/stop").json()["written"]), "the stop was not written")
    fresh(service, "DELETE", "/api/v1/stop", params={"reason": "no smoke"})
    until(lambda: not fresh(service, "GET", "/api/v1/stop").json()["active"], "it was not lifted")
    trail = [entry for entry in service.api("GET", "/audit").json()["items"] if "stop" in entry["action"]]
    assert [(entry["action"], entry["reason"]) for entry in trail[:2]] == [
        ("stop.lifted", "no smoke"),
        ("stop.set", "smoke"),
    ]


@pytest.mark.parametrize("keys", [False, True])
def test_who_is_known_asks_nobody(start: StartService, monkeypatch: pytest.MonkeyPatch, keys: bool) -> None:
    monkeypatch.setattr("robomend.api.gate.FRESH_S", 1000.0)
    monkeypatch.setattr(control_lane, "USUAL_S", 1000.0)  # what the event loop would be waited for
    service = start()
    headers = {"Authorization": f"Bearer {service.key('operator')}"} if keys else {}
    assert service.api("GET", "/robots", headers=headers).status_code == 200
    with held_loop(service):
        stopped = fresh(service, "POST", "/api/v1/stop", json={"reason": "smoke"}, headers=headers)
        assert stopped.json()["active"]


def test_who_lifts_a_stop_is_not_who_was_let_in_earlier(
    start: StartService, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever was let in before there were keys may stop while the event loop is held, and no more."""
    monkeypatch.setattr(control_lane, "UNKNOWN_S", 0.3)
    service = start()
    assert service.api("GET", "/robots").status_code == 200  # nobody needs a key
    service.key("operator")
    with held_loop(service):
        assert fresh(service, "POST", "/api/v1/stop", json={"reason": "smoke"}).status_code == 202
        assert fresh(service, "DELETE", "/api/v1/stop", params={"reason": "mine"}).status_code == 503
    monkeypatch.setattr(control_lane, "UNKNOWN_S", 60.0)
    assert fresh(service, "DELETE", "/api/v1/stop", params={"reason": "mine"}).status_code == 401
    assert service.runtime.repairs.switch.active


def test_they_answer_on_a_connection_that_is_used_again(service: Service) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", int(service.url.rsplit(":", 1)[1]), timeout=20)
    for _ in range(3):
        connection.request("GET", "/version-info")
        assert connection.getresponse().read()
    used = connection.sock
    with held_loop(service):
        body, kind = b'{"reason": "smoke"}', {"Content-Type": "application/json"}
        connection.request("POST", "/api/v1/stop", body, kind)
        assert connection.sock is used
        answer = connection.getresponse()
        assert (answer.status, json.loads(answer.read())["active"]) == (202, True)
    connection.close()
    until(lambda: bool(fresh(service, "GET", "/api/v1/stop").json()["written"]), "the stop was not written")
    fresh(service, "DELETE", "/api/v1/stop", params={"reason": "no smoke"})
    until(lambda: not fresh(service, "GET", "/api/v1/stop").json()["active"], "it was not lifted")


@pytest.mark.parametrize("half", [True, False], ids=["it reads the answer", "it is gone"])
def test_a_stop_is_in_force_though_its_client_sends_no_more(start: StartService, half: bool) -> None:
    service = start()
    body = b'{"reason": "smoke"}'
    head = b"POST /api/v1/stop HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    for sent in (body[:-1], body):
        with service.connect() as connection:
            connection.sendall(head + b"Content-Length: %d\r\n\r\n" % len(body) + sent)
            if half:
                connection.shutdown(socket.SHUT_WR)
                answer = b"".join(iter(lambda: connection.recv(65536), b""))
                assert answer.startswith(b"HTTP/1.1 20" if sent == body else b"")
        assert sent == body or not service.runtime.repairs.switch.active
    until(lambda: service.runtime.repairs.switch.active, "it is not in force", 60)


def test_a_frozen_loop_is_neither_healthy_nor_ready(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_probe, "FROZEN_S", 0.05)
    monkeypatch.setattr("robomend.api.routers.operation.DELAY_S", 0.05)
    with held_loop(service):
        until(lambda: fresh(service, "GET", "/healthz").status_code == 503, "healthy while it is frozen")
        assert fresh(service, "GET", "/healthz").json()["code"] == "frozen"
        assert fresh(service, "GET", "/readyz").status_code == 503


def test_a_stop_does_not_wait_for_the_disk(start: StartService) -> None:
    service = start()
    with hanging_writes(service):
        stopped = service.api("POST", "/stop", json={"reason": "smoke"})
        assert (stopped.status_code, stopped.json()["active"]) == (202, True)
        lifted = service.api("DELETE", "/stop")
        assert (lifted.status_code, lifted.json()["active"]) == (202, True)
        assert "until then the stop stays" in lifted.json()["detail"]
        assert service.runtime.repairs.switch.active
    until(lambda: service.api("GET", "/stop").json()["written"], "it was not written")
    assert not service.api("GET", "/stop").json()["active"]


def test_a_stop_on_a_full_disk_is_in_force_and_written_when_there_is_room(
    start: StartService, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = start(), start()
    full = threading.Event()
    full.set()
    write = one.runtime.store.write

    async def refuse(*arguments: Any, **options: Any) -> Any:
        if full.is_set():
            raise StoreFull("no space left on the disk")
        return await write(*arguments, **options)

    monkeypatch.setattr(one.runtime.store, "write", refuse)
    stopped = one.api("POST", "/stop", json={"reason": "smoke"})
    assert (stopped.status_code, stopped.json()["active"]) == (202, True)
    until(lambda: "no space left" in one.api("GET", "/stop").json()["detail"], "the reason is not told")
    assert not other.api("GET", "/stop").json()["active"]
    # it tells what is known, where the disk cannot be tried in time
    until(lambda: one.http.get("/readyz").status_code == 503, "ready while nothing can be written")
    full.clear()
    until(lambda: bool(other.api("GET", "/stop").json()["active"]), "the other instance did not hear of it")
    [entry] = [e for e in one.api("GET", "/audit").json()["items"] if e["action"] == "stop.set"]
    assert (entry["actor"], entry["reason"]) == ("local", "smoke")


def test_a_known_key_stops_while_the_database_does_not_answer(
    start: StartService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_lane, "UNKNOWN_S", 0.3)
    service = start()
    operator, viewer = ({"Authorization": f"Bearer {service.key(role)}"} for role in ("operator", "viewer"))
    assert service.api("GET", "/robots", headers=operator).status_code == 200

    async def hang(*_: Any) -> Any:
        await service.runtime.app.state.never.wait()

    service.runtime.app.state.never = asyncio.Event()
    monkeypatch.setattr(service.runtime.store, "read", hang)
    service.runtime.app.state.gate.ring.forget()
    assert fresh(service, "POST", "/api/v1/stop", json={}, headers=viewer).status_code == 403
    assert fresh(service, "POST", "/api/v1/stop", json={}, headers=operator).json()["active"]
    unknown = {"Authorization": "Bearer rm_" + "x" * 43}
    assert fresh(service, "POST", "/api/v1/stop", json={}, headers=unknown).status_code == 503
    service.loop.call_soon_threadsafe(service.runtime.app.state.never.set)


@pytest.mark.parametrize("step", [1, 12])
def test_a_first_line_in_pieces_finds_its_way(service: Service, step: int) -> None:
    for line, expected in ((b"GET /healthz", b'"ok"'), (b"GET /version-info", b'"robomend"')):
        request = line + b" HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        with service.connect() as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for at in range(0, len(request), step):
                connection.sendall(request[at : at + step])
                time.sleep(0.002)  # so that each piece is a packet of its own: nobody tells when it is read
            answer = b"".join(iter(lambda: connection.recv(65536), b""))
        assert answer.startswith(b"HTTP/1.1 200")
        assert expected in answer


def test_what_resembles_a_control_path_is_answered_as_ever(service: Service) -> None:
    for path in ("/healthzz", "/api/v1/stopwatch", "/readyz/x"):
        assert fresh(service, "GET", path).status_code == 404


def test_a_held_loop_is_told_in_the_log_and_measured(service: Service) -> None:
    def held() -> list[int]:
        return [line["ms"] for line in told if line["event"] == "event loop held"]

    with capture_logs() as told:
        with held_loop(service):
            until(lambda: service.runtime.watch.held_s > 0.2, "the watch does not see it")
        until(held, "nothing is told")
    assert max(held()) > 100
    metrics = service.http.get("/metrics").text
    name = "robomend_loop_delay_worst_seconds "
    worst = next(line for line in metrics.splitlines() if line.startswith(name))
    assert float(worst.split()[1]) > 0.1
    assert json.loads(service.http.get("/healthz").text) == {"status": "ok"}
