"""Two services on one database: what one takes in, the other knows."""

from __future__ import annotations

import asyncio
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, StartService, bad_sets
from tests.api.conftest import start as start  # the fixture


def test_an_instance_that_is_asked_knows_what_another_has_acknowledged(start: StartService) -> None:
    """Behind a round-robin proxy nobody chooses the instance; an event may still be on its way."""
    one, two = (start(inline_budget_s=5.0) for _ in range(2))  # diagnosed at once on a busy machine, too
    one.with_robot()
    for number in range(60):
        told, asked = (one, two) if number % 2 else (two, one)
        sentence = "not ok(scan)" if number % 3 else "ok(scan)"
        revision = told.observe(sentence).json()["revision"]
        found = asked.diagnosis()
        assert found["revision"] >= revision
        assert bad_sets(found) == ([{"hokuyo"}, {"hokuyo_node"}] if number % 3 else [set()])
        shown = asked.api("GET", "/robots/r1").json()
        assert (shown["revision"], shown["healthy"]) == (revision, number % 3 == 0)


def test_a_write_under_way_does_not_hide_what_another_has_acknowledged(start: StartService) -> None:
    """Both write the same revision; the one that comes too late must not take it for its own."""
    one, two = start(), start()
    one.with_robot()
    assert two.diagnosis()["revision"] == 0
    robots, held = two.runtime.robots, threading.Event()
    write = robots._store.write

    async def hold(*args: Any, **options: Any) -> Any:
        held.set()
        while held.is_set():
            await asyncio.sleep(0.01)
        return await write(*args, **options)

    with ThreadPoolExecutor(3) as clients, pytest.MonkeyPatch.context() as patch:
        patch.setattr(robots._store, "write", hold)
        late = clients.submit(two.observe, "ok(odom)")
        assert held.wait(60)
        assert one.observe("not ok(scan)").json()["revision"] == 1
        asked = clients.submit(two.api, "GET", "/robots/r1/observations")
        explained = clients.submit(two.diagnosis)
        time.sleep(0.3)  # both wait for that write
        patch.undo()
        held.clear()
        found = asked.result(20).json()
        assert found["revision"] >= 1
        assert "not ok(scan)" in {entry["literal"] for entry in found["observations"]}
        assert explained.result(20)["revision"] >= 1
        assert late.result(20).json()["revision"] == 2


def test_a_configuration_or_model_put_at_one_instance_is_the_others_at_once(start: StartService) -> None:
    one, two = start(), start()
    one.with_robot()
    assert two.observe("ok(scan)").status_code == 200  # it has the robot in memory now
    for number in range(20):
        told, asked = (one, two) if number % 2 else (two, one)
        etag = told.api("GET", "/robots/r1").headers["etag"]
        config = {"model": "tedusar", "observed_timeout_s": 40 + number}
        put = told.api("PUT", "/robots/r1", json=config, headers={"If-Match": etag})
        assert put.status_code == 200
        got = asked.api("GET", "/robots/r1")
        assert (got.json()["etag"], got.json()["config"]["observed_timeout_s"]) == (
            put.json()["etag"],
            40 + number,
        )
        source = f"{TEDUSAR}\nproperties: {{fresh{number}: {{}}}}\n"
        told.api("PUT", "/models/tedusar", json={"source": source}, headers={"If-Match": "*"})
        assert asked.observe(f"ok(fresh{number})").status_code == 200


def test_a_robot_deleted_at_one_instance_is_gone_at_the_other(start: StartService) -> None:
    one, two = start(), start()
    one.with_robot()
    assert two.diagnosis()["revision"] == 0
    assert one.api("DELETE", "/robots/r1", headers={"If-Match": "*"}).status_code == 204
    for path in ("", "/diagnosis", "/observations", "/probes", "/board"):
        assert two.api("GET", f"/robots/r1{path}").status_code == 404
    assert two.observe("ok(scan)").status_code == 404
