"""A batch that says nothing new: it renews evidence and lifetimes, and adds nothing to the database."""

from __future__ import annotations

import time
from typing import Any

import pytest
from sqlalchemy import func, select
from tests.api.conftest import Service, StartService, bad_sets
from tests.waiting import until

from robomend.store import Transaction, View, diagnoses, observations, repairs, schema
from robomend.store.records import StoredObs
from robomend_client.literals import Atom

SCAN = Atom("ok", ("scan",))


def rows(service: Service) -> dict[str, int]:
    """Return how many rows each table has."""

    def count(view: View) -> dict[str, int]:
        tables = schema.metadata.sorted_tables
        counted = {table: select(func.count()).select_from(table) for table in tables}
        # How a robot is, is told by another task, late, and not at all if it was unknown for a moment only.
        counted[schema.events] = counted[schema.events].where(schema.events.c.kind != "robot")
        return {table.name: view.rows(count)[0][0] for table, count in counted.items()}

    found: dict[str, int] = service.run(service.runtime.store.read(count))
    return found


def is_diagnosed(service: Service, revision: int) -> bool:
    """Return whether the event of this revision's diagnosis is on the disk."""

    latest = service.run(service.runtime.store.read(diagnoses.latest, "r1"))
    return latest is not None and latest.revision == revision


def stored(service: Service, robot: str) -> StoredObs:
    """Return OBS as it is on the disk."""
    found: StoredObs = service.run(service.runtime.store.read(observations.obs, robot))
    return found


@pytest.mark.parametrize(("lifetime", "dated"), [({}, False), ({"lifetime_s": 5}, True)])
def test_it_adds_no_row(start: StartService, lifetime: dict[str, Any], dated: bool) -> None:
    service = start()
    service.with_robot()

    def say(number: int) -> tuple[int, list[str]]:
        stamp = {"time": time.time_ns()} if dated else {}
        body = {"observations": ["not ok(scan)", "ok(odom)"], "source": "agent", **stamp, **lifetime}
        keyed = {"Idempotency-Key": f"key-{number}"} if dated else {}
        answer = service.api("POST", "/robots/r1/observations", json=body, headers=keyed).json()
        return answer["revision"], answer["changed"]

    assert say(0) == (1, ["not ok(scan)", "ok(odom)"])
    until(lambda: is_diagnosed(service, 1), "its diagnosis is kept")
    assert say(1) == (1, [])  # what lives on is in rows of OBS from here on, and no longer in the batch only
    before = rows(service)
    assert [say(number) for number in range(2, 30)] == [(1, [])] * 28
    assert rows(service) == before
    assert bad_sets(service.diagnosis()) == [{"hokuyo"}, {"hokuyo_node"}]
    assert say(30) == (1, [])


def test_its_lifetime_is_on_the_disk_all_the_same(service: Service) -> None:
    service.with_robot("lasting")
    service.observe("ok(scan)", robot="lasting", lifetime_s=50)
    [before] = stored(service, "lasting").entries
    assert service.observe("ok(scan)", robot="lasting", lifetime_s=500).json() == {
        "revision": 1,
        "changed": [],
        "refused": [],
    }
    [after] = stored(service, "lasting").entries
    assert before.expires_ns is not None
    assert after.expires_ns is not None
    assert after.expires_ns > before.expires_ns + 400 * 10**9
    assert after.since_ns != before.since_ns


def test_it_is_evidence_in_the_history_while_a_repair_is_open(service: Service) -> None:
    service.with_robot("open")
    assert service.observe("not ok(scan)", robot="open").json()["revision"] == 1
    assert service.observe("not ok(scan)", robot="open").json()["revision"] == 1

    def begin(tx: Transaction) -> str:
        return repairs.create(tx, "open", state="planning", data={}).id

    service.run(service.runtime.store.write(begin, robots=("open",)))
    assert [service.observe("not ok(scan)", robot="open").json()["revision"] for _ in range(2)] == [2, 3]
    kept = service.run(service.runtime.store.read(observations.history, "open")).items
    assert [batch.revision for batch in kept] == [3, 2, 1]


def test_who_reports_it_first_is_told_even_so(service: Service) -> None:
    service.with_robot("first")
    service.observe("ok(scan)", robot="first", source="one")
    assert [
        service.observe("ok(scan)", robot="first", source="two").json()["revision"] for _ in range(3)
    ] == [2, 2, 2]
    told = service.api("GET", "/audit", params={"robot": "first", "action": "observations.report"}).json()[
        "items"
    ]
    assert [entry["subject"] for entry in told] == ["two", "one"]


def test_a_repeated_request_of_an_undated_batch_undoes_nothing(service: Service) -> None:
    service.with_robot("again")
    service.observe("ok(scan)", robot="again")
    key = {"Idempotency-Key": "k"}

    def post() -> Any:
        body = {"observations": ["ok(scan)"]}
        return service.api("POST", "/robots/again/observations", json=body, headers=key).json()

    first = post()
    assert (first["revision"], first["changed"]) == (1, [])
    assert service.observe("not ok(scan)", robot="again").json()["revision"] == 2
    assert post() == first
    assert [str(entry.literal) for entry in stored(service, "again").entries] == ["not ok(scan)"]


def test_what_another_instance_heard_meanwhile_makes_it_news(start: StartService) -> None:
    one, two = start(), start()
    one.with_robot()
    one.observe("ok(scan)")
    two.observe("ok(odom)")  # each has reported, and holds the robot
    for number in range(20):
        revision = one.observe("not ok(scan)").json()["revision"]
        answer = two.observe("ok(scan)").json()  # known, as far as it has heard
        assert (answer["revision"], answer["changed"]) == (revision + 1, ["ok(scan)"]), number


def test_a_lifetime_that_another_instance_renewed_does_not_end(start: StartService) -> None:
    one, two = start(), start()
    for number in range(10):
        robot = f"r{number}"
        one.with_robot(robot)
        one.observe("not ok(scan)", robot=robot, lifetime_s=2.0)
        assert bad_sets(two.diagnosis(robot, after=0, wait_s=20)) == [{"hokuyo"}, {"hokuyo_node"}]
        if one.observe("not ok(scan)", robot=robot, lifetime_s=3600).json()["revision"] == 1:
            break  # else it had ended before it was renewed, on a busy computer

    def left_s() -> float:
        entry = two.runtime.robots.memory.states[robot].obs.get(SCAN)
        return 0.0 if entry is None or entry.expires_ns is None else entry.expires_ns / 1e9 - time.time()

    until(lambda: left_s() > 1000, "the other instance does not hear of it", 60)
    assert bad_sets(two.diagnosis(robot)) == [{"hokuyo"}, {"hokuyo_node"}]
    assert one.api("GET", f"/robots/{robot}").json()["revision"] == 1
