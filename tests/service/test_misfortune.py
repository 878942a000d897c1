"""The disk is full, the database goes away, clients are slow or half gone: what others get meanwhile."""

from __future__ import annotations

import asyncio
import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from tests.api.conftest import TEDUSAR
from tests.postgres import PostgresServer
from tests.postgres import postgres_server as postgres_server  # fixtures
from tests.postgres import postgres_url as postgres_url
from tests.waiting import until

from robomend_bench.service.fleet import prepare
from robomend_bench.service.hostile import Crowd, crowding
from robomend_bench.service.process import served
from robomend_bench.service.robots import SimulatedRobot, body
from robomend_bench.service.wire import connect, request


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
        process.wait(10)
        assert process.stdout is not None
        process.stdout.close()


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
    return httpx.Client(base_url=f"{url}/api/v1", timeout=30)


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
            until(lambda: httpx.get(f"{service.url}/readyz", timeout=30).status_code == 503, "it is ready")
            unready = httpx.get(f"{service.url}/readyz", timeout=30)
            assert (unready.status_code, unready.headers["retry-after"]) == (503, "1")
        finally:
            postgres_server.start()
        deadline = time.monotonic() + 30
        while (answer := http.post("/robots/r1/observations", json=observation)).status_code != 200:
            assert answer.status_code == 503, answer.text
            assert time.monotonic() < deadline
            time.sleep(0.1)
        assert http.get("/robots/r1/observations").json()["revision"] == answer.json()["revision"]
        while httpx.get(f"{service.url}/readyz", timeout=30).status_code != 200:
            assert time.monotonic() < deadline
            time.sleep(0.1)


@pytest.mark.timeout(120)
def test_slow_half_open_and_idle_clients_hold_nobody_up() -> None:
    crowd = Crowd(slow_readers=10, slow_writers=10, half_open=20, idle_streams=50)

    async def run(url: str) -> None:
        robots = [SimulatedRobot(f"b{number}", 1, faults=3) for number in range(10)]
        idle = SimulatedRobot("idle", 1, faults=1)
        await prepare(url, [*robots, idle])
        async with crowding(url, crowd, idle.name):
            connection = await connect(url)
            for robot in robots * 20:
                async with asyncio.timeout(10):
                    status, _ = await connection.ask(request("POST", robot.path, body(robot.change())))
                assert status == 200
            for robot in robots:
                found = await connection.api("GET", f"/robots/{robot.name}/observations")
                assert found["revision"] == robot.revision
            connection.close()

    with served() as service:
        asyncio.run(run(service.url))
        assert service.stop() == 0  # and they do not hold up its end
