"""Silence is not health: how a robot is, in words of its resource, its events and the metrics."""

from __future__ import annotations

import time

from tests.api.conftest import StartService
from tests.waiting import until

from robomend.repairs.headline import Headline, of_robot
from robomend.store import events


def test_what_should_be_observed_and_is_not_is_unknown(start: StartService) -> None:
    service = start()
    service.with_robot("r1", observed=["ok(odom)", "ok(joy)"])

    def robot() -> tuple[str, list[str]]:
        value = service.api("GET", "/robots/r1").json()
        assert value["healthy"] is {"healthy": True, "unhealthy": False}.get(value["state"])
        return value["state"], value["unknown"]

    assert robot() == ("unknown", ["ok(joy)", "ok(odom)"])

    def told() -> list[object]:
        page = service.run(service.runtime.store.read(events.after, 0))
        said = [event.data for event in page if event.data.get("what") == "health"]
        return [(data["state"], data["unknown"], data.get("reported")) for data in said]

    until(lambda: told() == [("unknown", ["ok(joy)", "ok(odom)"], False)], "that nothing was reported yet")
    service.api("POST", "/robots/r1/observations", json={"observations": ["ok(odom)"]})
    assert robot() == ("partly-unknown", ["ok(joy)"])
    service.api("POST", "/robots/r1/observations", json={"observations": ["ok(joy)"]})
    assert robot() == ("healthy", [])
    service.api("POST", "/robots/r1/observations", json={"observations": ["ok(odom)"], "lifetime_s": 0.4})
    until(lambda: robot() == ("partly-unknown", ["ok(odom)"]), "odom is unknown")  # it outlived its lifetime

    until(lambda: ("partly-unknown", ["ok(odom)"], None) in told(), "the event of it")
    service.api("POST", "/robots/r1/observations", json={"observations": ["not ok(odom)"]})
    assert robot() == ("unhealthy", [])

    assert 'robomend_robots_health{state="unhealthy"} 1.0' in service.http.get("/metrics").text


def test_healthy_since_does_not_reach_over_a_time_in_which_nobody_looked(start: StartService) -> None:
    service = start()
    service.with_robot("r1", observed=["ok(odom)"])

    def look(lifetime_s: float = 3600.0) -> None:
        now_ns = time.time_ns()  # it began to look just now
        body = {"observations": ["ok(odom)"], "lifetime_s": lifetime_s, "time": now_ns, "since": [now_ns]}
        service.api("POST", "/robots/r1/observations", json=body)

    def headline() -> Headline:
        return of_robot(service.run(service.runtime.robots.memory.latest("r1")), None)

    for _ in range(2):
        look()
    first = headline()
    look(0.4)
    until(lambda: "Nothing is heard" in headline().text(0), "that nobody looks any more")
    for _ in range(2):
        look()
    assert headline().text(0).startswith("Healthy since")
    assert first.since_ns is not None
    assert (headline().since_ns or 0) > first.since_ns
