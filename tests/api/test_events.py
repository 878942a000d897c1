"""Event streams: nothing is missed, whoever comes back goes on where he was, and nobody holds up the rest."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

import httpx
import pytest
from tests.api.conftest import Service, StartService
from tests.waiting import until

from robomend.api import ingestion, streams
from robomend.store import Transaction, api_keys


@contextmanager
def following(
    service: Service, path: str = "/events", last: str | None = None
) -> Iterator[Iterator[dict[str, Any]]]:
    """Open a stream; its head has come, so whatever happens from now on must come."""
    headers = {} if last is None else {"Last-Event-ID": last}
    with httpx.stream("GET", f"{service.url}/api/v1{path}", headers=headers, timeout=60) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        yield parsed(answer.iter_lines())


def parsed(lines: Iterator[str]) -> Iterator[dict[str, Any]]:
    """Yield the events of a stream, by the rules of the standard as far as we need them."""
    fields: dict[str, str] = {}
    for line in lines:
        if not line and "data" in fields:
            yield {**fields, "data": json.loads(fields["data"])}
        if not line:
            fields = {}
        name, _, value = line.partition(": ")
        if name:
            fields[name] = value


def take(events: Iterator[dict[str, Any]], kind: str, count: int) -> list[dict[str, Any]]:
    """Return the next events of one kind."""
    found: list[dict[str, Any]] = []
    while len(found) < count:
        event = next(events)
        if event["event"] == kind:
            found.append(event)
    return found


def test_a_change_and_its_diagnosis_come_in_order(start: StartService) -> None:
    service = start()
    service.with_robot()
    with following(service) as events:
        service.observe("not ok(scan)")
        observed = take(events, "observations", 1)[0]
        diagnosed = take(events, "diagnosis", 1)[0]
    assert observed["data"]["robot"] == diagnosed["data"]["robot"] == "r1"
    assert observed["data"]["data"]["changed"] == ["not ok(scan)"]
    assert int(observed["id"]) < int(diagnosed["id"])
    assert diagnosed["data"]["data"]["result"]["diagnoses"][0]["bad"] == ["hokuyo"]


def test_a_stream_is_of_the_kinds_and_the_robot_that_are_asked_for_and_brief_if_wanted(
    start: StartService,
) -> None:
    service = start()
    service.with_robot("r1")
    service.with_robot("r2")
    path = "/events?about=r2&kind=observations&kind=stop&brief=true"

    def happen() -> None:
        service.observe("not ok(scan)", robot="r1")
        service.observe("not ok(map)", robot="r2")
        service.api("POST", "/stop", json={"reason": "told without its data"})

    with following(service, path) as events:
        happen()
        live = [next(events), next(events)]
    with following(service, path, last=str(int(live[0]["id"]) - 1)) as events:
        replayed = [next(events), next(events)]
    for told in (live, replayed):
        assert [(event["event"], event["data"]["robot"]) for event in told] == [
            ("observations", "r2"),
            ("stop", None),
        ]
        assert [event["data"]["data"] for event in told] == [{}, {}]
    assert service.api("GET", "/events", params={"kind": "nonsense"}).status_code == 422


def test_a_brief_stream_pings_with_an_event(start: StartService) -> None:
    service = start(ping_s=0.05)
    with following(service, "/events?brief=true") as events:
        assert next(events)["event"] == "ping"


def test_what_is_sent_live_is_what_the_log_has(start: StartService) -> None:
    service = start()
    service.with_robot()
    with following(service) as events, following(service, "/robots/r1/events") as own:
        service.observe("not ok(scan)")
        service.observe("ok(scan)", "not ok(map)")
        live = take(events, "observations", 1) + [next(events) for _ in range(3)]
        of_robot = take(own, "observations", 1) + [next(own) for _ in range(3)]
    with following(service, last=str(int(live[0]["id"]) - 1)) as events:
        assert [next(events) for _ in range(4)] == live == of_robot


def test_a_busy_stream_ends_when_its_key_is_revoked(
    start: StartService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streams, "STILL_S", 0.1)
    service = start()
    service.with_robot()
    own = {"Authorization": f"Bearer {service.key('robot', 'r1')}"}
    head = {"Authorization": f"Bearer {service.key('viewer')}"}

    def revoke(tx: Transaction) -> None:
        [viewer] = [key for key in api_keys.every(tx) if key.role == "viewer"]
        api_keys.revoke(tx, viewer.id)

    def observe(sentence: str) -> None:
        body = {"observations": [sentence]}
        assert service.api("POST", "/robots/r1/observations", json=body, headers=own).status_code == 200

    with httpx.stream("GET", f"{service.url}/api/v1/events", headers=head, timeout=60) as answer:
        lines = answer.iter_lines()
        observe("not ok(scan)")
        while "observations" not in next(lines):
            pass
        service.run(service.runtime.store.write(revoke))
        service.runtime.app.state.gate.ring.forget()
        ended = threading.Thread(target=lambda: [None for _ in lines])
        ended.start()
        for number in count():
            if not ended.is_alive():
                break
            observe("ok(scan)" if number % 2 else "not ok(scan)")


def test_a_stream_is_kept_alive_after_its_events(start: StartService) -> None:
    service = start(ping_s=0.05)
    service.with_robot()
    with httpx.stream("GET", f"{service.url}/api/v1/events", timeout=60) as answer:
        lines = answer.iter_lines()
        service.observe("not ok(scan)")
        while "diagnosis" not in next(lines):
            pass
        while next(lines) != ": ping":
            pass


def test_whoever_comes_back_misses_nothing_and_gets_nothing_twice(start: StartService) -> None:
    service = start()
    service.with_robot()
    with following(service) as events:
        service.observe("not ok(scan)")
        last = take(events, "observations", 1)[0]["id"]
    for number in range(30):
        service.observe("ok(map)" if number % 2 else "not ok(map)")
    with following(service, last=last) as events:
        service.observe("on(jaguar)")
        found = take(events, "observations", 31)
    assert [event["data"]["data"]["revision"] for event in found] == list(range(2, 33))


def test_an_id_that_nobody_gave_replays_from_the_oldest_after_a_gap(start: StartService) -> None:
    service = start()
    service.with_robot()
    service.observe("not ok(scan)")
    for asked in ("junk", "-5", "999999999", "1" * 40, "1.5"):
        with following(service, last=asked) as events:
            first, second = next(events), next(events)
        assert (first["event"], first["data"]["asked"]) == ("gap", asked)
        assert second["event"] == "model"
        assert int(second["id"]) == first["data"]["oldest"]


def test_a_slow_reader_is_served_from_the_log(start: StartService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "PENDING", 5)
    monkeypatch.setattr(streams, "PAGE", 7)
    monkeypatch.setattr(ingestion, "GROUP", 10)  # 120 revisions, faster than one write each
    service = start()
    service.with_robot()
    sock = service.connect()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    with sock:
        sock.sendall(b"GET /api/v1/robots/r1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        received = sock.recv(1)
        lines = "".join(
            json.dumps({"observations": ["ok(map)" if n % 2 else "not ok(map)"]}) + "\n" for n in range(400)
        )
        for _ in range(3):
            service.api(
                "POST",
                "/robots/r1/observations",
                content=lines,
                headers={"Content-Type": "application/x-ndjson"},
            )
        last = service.api("GET", "/robots/r1").json()["revision"]
        sock.settimeout(20)
        while f'"revision":{last},'.encode() not in received:
            received += sock.recv(1 << 20)
    ids = [int(line[4:]) for line in received.split(b"\n") if line.startswith(b"id: ")]
    assert ids == sorted(set(ids))
    revisions = received.count(b"event: observations")
    assert revisions == last


def test_a_stream_that_nobody_reads_is_dropped(start: StartService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ingestion, "GROUP", 1)
    service = start(send_timeout_s=0.2)
    service.with_robot()
    hub = service.runtime.hub
    sock = service.connect()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    lines = "".join(
        json.dumps({"observations": ["ok(map)" if n % 2 else "not ok(map)"]}) + "\n" for n in range(400)
    )
    with sock:
        sock.sendall(b"GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        until(lambda: hub.count == 1, "the stream is open")

        def dropped() -> bool:
            head = {"Content-Type": "application/x-ndjson"}
            service.api("POST", "/robots/r1/observations", content=lines, headers=head)
            return hub.count == 0

        until(dropped, "the stream is dropped")


def test_too_many_streams_are_refused_and_room_comes_back(start: StartService) -> None:
    service = start(max_streams=2)
    with following(service), following(service):
        answer = service.api("GET", "/events")
        assert answer.status_code == 503
        assert answer.json()["code"] == "overloaded"
        assert "retry-after" in answer.headers
    until(lambda: not service.runtime.hub.count, "their room comes back")
    with following(service):
        pass


def test_a_stream_ends_when_its_key_is_revoked(start: StartService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robomend.api.gate.FRESH_S", 0.1)
    monkeypatch.setattr("robomend.api.streams.STILL_S", 0.1)
    service, other = start(ping_s=0.1), start()
    service.key("admin")
    head = {"Authorization": f"Bearer {service.key('viewer')}"}

    def revoke(tx: Transaction) -> None:
        [viewer] = [key for key in api_keys.every(tx) if key.role == "viewer"]
        api_keys.revoke(tx, viewer.id)

    with httpx.stream("GET", f"{service.url}/api/v1/events", headers=head, timeout=60) as answer:
        lines = answer.iter_lines()
        assert next(lines) is not None
        other.run(other.runtime.store.write(revoke))  # whichever instance it is said to
        for _ in lines:  # it ends; else this reads for ever
            pass
    assert service.http.get("/api/v1/events", headers=head).status_code == 401
