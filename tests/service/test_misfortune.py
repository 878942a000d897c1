"""The disk is full, the database goes away, clients are slow or half gone: what others get meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import resource
import shlex
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import httpx
import psycopg
import pytest
from tests.api.conftest import TEDUSAR
from tests.freezing import frozen
from tests.postgres import PostgresServer
from tests.postgres import postgres_server as postgres_server  # fixtures
from tests.postgres import postgres_url as postgres_url
from tests.store.test_damage import overwrite, written
from tests.waiting import until

from robomend_bench.service.load import SimulatedRobot, body, prepare
from robomend_bench.service.process import served
from robomend_bench.service.wire import EventStream, address, connect, follow, request


@contextmanager
def on_a_small_disk(data: Path, size: str) -> Iterator[tuple[str, Path]]:
    """A service whose data folder is a disk of its own; yields its URL and the folder as it sees it."""
    program = [sys.executable, "-m", "robomend", "serve", "--port", "0", "--announce", "--data", str(data)]
    mount = f"mount -t tmpfs -o size={size} tmpfs {shlex.quote(str(data))} && exec {shlex.join(program)}"
    as_root = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    process = subprocess.Popen(  # the disk is seen by this process alone, and goes with it
        ["unshare", "--mount", *as_root, "sh", "-c", mount], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line, "the service did not start on a disk of its own"
        yield json.loads(line)["url"], Path(f"/proc/{process.pid}/root{data}")
    finally:
        process.kill()
        process.wait(60)
        assert process.stdout is not None
        process.stdout.close()


def test_who_has_found_the_database_damaged_is_not_ready_whatever_else_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "robomend.db"
    asyncio.run(written(path))
    overwrite(path, "audit")
    with served(["--data", str(tmp_path)]) as service, client_of(service.url) as http:
        assert httpx.get(f"{service.url}/readyz", timeout=60).status_code == 200
        found = http.get("/audit")
        assert (found.status_code, found.json()["code"]) == (503, "store-damaged"), found.text
        assert http.get("/robots").status_code == 200
        until(lambda: httpx.get(f"{service.url}/readyz", timeout=60).status_code == 503, "it is ready")
        unready = httpx.get(f"{service.url}/readyz", timeout=60)
        assert unready.status_code == 503
        assert "put a copy in its place" in unready.json()["checks"]["store"]["detail"]


def test_a_full_disk_refuses_writes_with_507_and_reading_goes_on(tmp_path: Path) -> None:
    with (
        on_a_small_disk(tmp_path, "8m") as (url, disk),
        client_of(url) as http,
    ):
        (disk / "filler").write_bytes(b"x" * (4 << 20))
        http.put("/models/m", json={"source": TEDUSAR})
        assert http.put("/robots/r1", json={"model": "m"}).status_code == 201
        accepted = 0
        for number in range(1000):
            sentence = "ok(map)" if number % 2 else "not ok(map)"
            told = {"observations": [sentence] * 300, "source": "s" * 100}
            answer = http.post("/robots/r1/observations", json=told)
            if answer.status_code != 200:
                break
            accepted += 1
        assert answer.status_code == 507, answer.text
        assert answer.json()["code"] == "store-full"
        assert accepted > 0
        assert http.get("/robots/r1/observations").json()["revision"] == accepted
        assert http.get("/robots/r1/diagnosis").status_code == 200
        assert httpx.get(f"{url}/healthz").status_code == 200
        (disk / "filler").unlink()
        assert http.post("/robots/r1/observations", json=told).json()["revision"] == accepted + 1


def client_of(url: str) -> httpx.Client:
    """Return a client of the interface."""
    return httpx.Client(base_url=f"{url}/api/v1", timeout=60)


def test_a_database_that_is_gone_is_503_until_it_is_back(
    postgres_server: PostgresServer, postgres_url: str
) -> None:
    with served(["--database", postgres_url]) as service, client_of(service.url) as http:
        http.put("/models/m", json={"source": TEDUSAR})
        assert http.put("/robots/r1", json={"model": "m"}).status_code == 201
        observation = {"observations": ["not ok(scan)"]}
        assert http.post("/robots/r1/observations", json=observation).status_code == 200
        postgres_server.crash()
        try:
            answer = http.post("/robots/r1/observations", json=observation)
            assert answer.status_code == 503, answer.text
            assert int(answer.headers["retry-after"]) > 0
            assert http.get("/models").status_code == 503
            assert httpx.get(f"{service.url}/healthz").status_code == 200
            # An answer does not wait for the database; what is known of it is a second old at most.
            until(lambda: httpx.get(f"{service.url}/readyz", timeout=60).status_code == 503, "it is ready")
            unready = httpx.get(f"{service.url}/readyz", timeout=60)
            assert (unready.status_code, unready.headers["retry-after"]) == (503, "1")
        finally:
            postgres_server.start()
        answers: list[httpx.Response] = []

        def taken() -> bool:
            answers.append(http.post("/robots/r1/observations", json=observation))
            return answers[-1].status_code == 200

        until(taken, "it is taken")
        assert {answer.status_code for answer in answers} <= {200, 503}
        assert http.get("/robots/r1/observations").json()["revision"] == answers[-1].json()["revision"]
        until(lambda: httpx.get(f"{service.url}/readyz", timeout=60).status_code == 200, "it is ready")


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Somebody else writes to a SQLite database, and does not end."""
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    try:
        yield
    finally:
        other.close()


def processes_of(server: PostgresServer) -> list[int]:
    assert server.process is not None
    main = server.process.pid
    served_by = Path(f"/proc/{main}/task/{main}/children").read_text().split()
    return [main, *map(int, served_by)]


@contextmanager
def in_the_middle_of_a_write(postgres_url: str) -> Iterator[None]:
    """Another instance holds what its transaction holds last, and does not end."""
    with psycopg.connect(postgres_url) as other:
        other.execute("UPDATE counters SET value = value + 0 WHERE name = 'event'")
        yield


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_an_instance_that_cannot_write_is_not_ready_though_nobody_writes_or_asks(
    tmp_path: Path, request: pytest.FixtureRequest, kind: str
) -> None:
    url = request.getfixturevalue("postgres_url") if kind == "postgresql" else ""
    with served(["--database", url] if url else ["--data", str(tmp_path)]) as service:

        def waits_s() -> float:
            text = httpx.get(f"{service.url}/metrics", timeout=60).text
            [line] = [line for line in text.splitlines() if line.startswith(OLDEST)]
            return float(line.removeprefix(OLDEST))

        with in_the_middle_of_a_write(url) if url else locked(tmp_path / "robomend.db"):
            until(lambda: waits_s() > 2.1, "no write was tried", 60)
            first = httpx.get(f"{service.url}/readyz", timeout=60)
            assert first.status_code == 503, first.text
            assert httpx.get(f"{service.url}/healthz", timeout=60).status_code == 200
        until(lambda: httpx.get(f"{service.url}/readyz", timeout=60).status_code == 200, "not ready", 60)


OLDEST = "robomend_store_oldest_write_seconds "

FROZEN_S = 12.0
"""Longer than a writer waits for SQLite's lock."""


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_database_that_is_frozen_loses_nothing_and_stops_nobody_from_stopping(
    tmp_path: Path, postgres_server: PostgresServer, postgres_url: str, kind: str, long: bool
) -> None:
    on = ["--database", postgres_url] if kind == "postgresql" else ["--data", str(tmp_path)]
    with served(on) as service, client_of(service.url) as http, ThreadPoolExecutor(1) as clients:
        http.put("/models/m", json={"source": TEDUSAR})
        assert http.put("/robots/r1", json={"model": "m"}).status_code == 201

        def report(sentence: str) -> httpx.Response:
            body = {"observations": [sentence]}
            return httpx.post(f"{service.url}/api/v1/robots/r1/observations", json=body, timeout=90)

        assert report("ok(map)").json()["revision"] == 1
        thaws = time.monotonic() + (FROZEN_S if long or kind == "sqlite" else 0.0)
        with (
            frozen(*processes_of(postgres_server))
            if kind == "postgresql"
            else locked(tmp_path / "robomend.db")
        ):
            under_way = clients.submit(report, "not ok(map)")
            until(lambda: httpx.get(f"{service.url}/readyz", timeout=60).status_code == 503, "ready", 60)
            assert httpx.get(f"{service.url}/healthz", timeout=60).status_code == 200
            stopped = httpx.post(f"{service.url}/api/v1/stop", json={"reason": "smoke"}, timeout=60)
            assert (stopped.status_code, stopped.json()["active"]) == (202, True)
            until(lambda: time.monotonic() > thaws, "time itself is what is tested", 60)
        answer = under_way.result(90)
        assert answer.status_code in {200, 503}, answer.text
        until(lambda: httpx.get(f"{service.url}/readyz", timeout=60).status_code == 200, "not ready", 60)
        until(lambda: http.get("/stop").json()["written"], "the stop is not on disk", 60)
        assert http.get("/stop").json()["active"]
        until(lambda: report("ok(scan)").status_code == 200, "nothing is accepted any more", 60)
        told = http.get("/robots/r1/history").json()["items"]
        kept = [one["literal"] for line in told for one in line["data"]["observations"]]
        assert kept.count("not ok(map)") == (answer.status_code == 200)


def test_where_memory_ends_workers_are_missing_and_the_service_lives(tmp_path: Path) -> None:
    with served(["--data", str(tmp_path)]) as service, client_of(service.url) as http:
        assert http.put("/models/m", json={"source": TEDUSAR}).status_code == 201
        assert http.put("/robots/r1", json={"model": "m"}).status_code == 201
        used = int(Path(f"/proc/{service.pid}/statm").read_text().split()[0]) * resource.getpagesize()
        resource.prlimit(service.pid, resource.RLIMIT_AS, (used + (4 << 20), resource.RLIM_INFINITY))
        many = "".join(f"  n{n}: {{publishes: {{t{n}: []}}}}\n" for n in range(3000))
        large = {"source": f"robomend: 1\nname: large\nnodes:\n{many}", "observations": ["not ok(t7)"]}
        for _ in range(3):
            refused = http.post("/diagnoses", json=large)
            assert refused.status_code == 503, refused.text
        assert httpx.get(f"{service.url}/healthz", timeout=60).status_code == 200
        stopped = http.post("/stop", json={"reason": "smoke"})
        assert stopped.status_code in {200, 202}, stopped.text
        resource.prlimit(service.pid, resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        until(lambda: http.post("/diagnoses", json=large).status_code == 200, "no worker came back", 90)


# --- clients that are slow, half gone or only listening
#
# slow readers     an event stream of everything, read a byte a second, the smallest buffer
# slow writers     a body of a kilobyte, sent a byte a second
# half-open        a connection with half a request line, and silence
# idle streams     an event stream on which nothing happens


@asynccontextmanager
async def crowding(url: str, idle_robot: str) -> AsyncIterator[None]:
    """Keep the crowd there while the block runs."""
    tasks = [
        *(asyncio.create_task(_slow_reader(url)) for _ in range(10)),
        *(asyncio.create_task(_slow_writer(url, idle_robot)) for _ in range(10)),
        *(asyncio.create_task(_half_open(url)) for _ in range(20)),
    ]
    streams: list[EventStream] = []
    try:
        for _ in range(50):
            streams.append(await follow(url, lambda _: None, f"/api/v1/robots/{idle_robot}/events"))
        await asyncio.sleep(1.0)  # until all of them are there
        yield
    finally:
        for stream in streams:
            stream.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _connection(url: str) -> socket.socket:
    client = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # the kernel's least
    client.setblocking(False)
    await asyncio.get_running_loop().sock_connect(client, address(url))
    return client


async def _slow_reader(url: str) -> None:
    loop = asyncio.get_running_loop()
    while True:
        with contextlib.suppress(OSError), await _connection(url) as client:
            await loop.sock_sendall(client, request("GET", "/api/v1/events"))
            while await loop.sock_recv(client, 1):
                await asyncio.sleep(1.0)  # that is what slow means
        await asyncio.sleep(1.0)  # it was thrown out, and comes back


async def _slow_writer(url: str, robot: str) -> None:
    loop = asyncio.get_running_loop()
    wire = request("POST", f"/api/v1/robots/{robot}/observations", b" " * 1000)
    head, letters = wire[:-1000], wire[-1000:]
    while True:
        with contextlib.suppress(OSError), await _connection(url) as client:
            await loop.sock_sendall(client, head)
            for position in range(len(letters)):
                await loop.sock_sendall(client, letters[position : position + 1])
                await asyncio.sleep(1.0)  # that is what slow means
        await asyncio.sleep(1.0)  # it was thrown out, and comes back


async def _half_open(url: str) -> None:
    loop = asyncio.get_running_loop()
    while True:
        with contextlib.suppress(OSError), await _connection(url) as client:
            await loop.sock_sendall(client, b"POST /api/v1/robots/")
            await loop.sock_recv(client, 1)  # nothing comes, until the service has had enough
        await asyncio.sleep(1.0)  # it was thrown out, and comes back


def test_slow_half_open_and_idle_clients_hold_nobody_up() -> None:

    async def run(url: str) -> None:
        robots = [SimulatedRobot(f"b{number}", 1, faults=3) for number in range(10)]
        idle = SimulatedRobot("idle", 1, faults=1)
        await prepare(url, [*robots, idle])
        async with crowding(url, idle.name):
            connection = await connect(url)
            for robot in robots * 20:
                async with asyncio.timeout(60):
                    status, _ = await connection.ask(request("POST", robot.path, body(robot.change())))
                assert status == 200
            for robot in robots:
                found = await connection.api("GET", f"/robots/{robot.name}/observations")
                assert found["revision"] == robot.revision
            connection.close()

    with served() as service:
        asyncio.run(run(service.url))
        assert service.stop() == 0  # and they do not hold up its end
