"""Drills in a data directory that the version before left, killed in the middle of three of them."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
from tests.api.conftest import Service, running
from tests.store.older import HERE, lay
from tests.waiting import until

from robomend.settings import Settings

ENDED = {"d-6zygevh9bq": ("cancelled", True), "d-m2mh9x6mcr": ("failed", False)}
"""Undone by a person, and abandoned; both of r1."""

INTERRUPTED = {"r1": "d-sm48tg9pd2", "r2": "d-j52wj67yw2", "r3": "d-tdj7zfch4h"}
"""While a person was asked for the fault, while it was watched, and while it was undone."""

LONG_S = 90.0
"""A safety net, on a busy computer."""


@pytest.fixture(scope="module")
def carried_over(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    data = tmp_path_factory.mktemp("older")
    lay(f"sqlite:///{data / 'robomend.db'}", "0007")
    with closing(sqlite3.connect(data / "robomend.db")) as lite:
        lite.executescript((HERE / "0007.drills.sqlite.sql").read_text(encoding="utf-8"))
    with running(Settings(port=0, data=data), repairs=True) as service:
        yield service


def drill(service: Service, drill: str) -> dict[str, Any]:
    found: dict[str, Any] = service.api("GET", f"/drills/{drill}").json()
    return found


def test_those_that_had_ended_are_read_as_they_were(carried_over: Service) -> None:
    listed = {one["id"]: one for one in carried_over.api("GET", "/robots/r1/drills").json()["items"]}
    assert listed.keys() == {*ENDED, INTERRUPTED["r1"]}
    for name, (state, undone) in ENDED.items():
        one = drill(carried_over, name)
        assert one == listed[name]
        assert (one["state"], one["undone"]) == (state, undone)
        assert (one["fault"], one["component"], one["undo"]) == ("device-unplugged", "lidar", "plug it in")
        assert one["finished_ns"] is not None
        assert one["reason"]
    page = carried_over.http.get("/ui/robots/r1")
    assert page.status_code == 200


@pytest.mark.parametrize("robot", INTERRUPTED)
def test_those_that_were_open_are_undone_and_end(carried_over: Service, robot: str) -> None:
    name = INTERRUPTED[robot]

    def now() -> dict[str, Any]:
        return drill(carried_over, name)

    until(lambda: now()["state"] == "undoing" and now()["waiting_for"], "a person is asked", LONG_S)
    assert now()["waiting_for"] == "plug it in"
    said = {"decision": "done", "reason": "it is in again"}
    assert carried_over.api("POST", f"/drills/{name}", json=said).is_success
    until(lambda: now()["state"] == "recovering", "it is undone", LONG_S)
    assert carried_over.observe("ok(scan)", robot=robot, source="lidar_observer").is_success
    until(lambda: now()["finished_ns"] is not None, "it ends", LONG_S)
    assert (now()["state"], now()["undone"]) == ("cancelled", True)
    assert now()["cut_short"]
    audit = carried_over.api("GET", "/audit", params={"robot": robot}).json()["items"]
    assert "drill.cancelled" in {entry["action"] for entry in audit}
