"""The observers of one host, and what is the matter with one of them."""

from __future__ import annotations

import pytest
from tests.robomend_bench.faults.small import ROBOT

from robomend_bench.faults.classes import Blind
from robomend_bench.faults.observing import PRESETS, HostObservers
from robomend_bench.faults.robot import find_robot

ALL = frozenset(ROBOT.nodes)
FAST = PRESETS["fast"]


def said(host: HostObservers, at_s: float, running: frozenset[str] = ALL) -> set[str] | None:
    found = host.check(at_s, running, {})
    return None if found is None else {str(literal) for literal in found[1]}


def fed(blind: Blind | None = None) -> HostObservers:
    """Return observers that have heard two seconds of a map at 10 Hz."""
    host = HostObservers(ROBOT, None, FAST, 0.0, blind)
    for tick in range(20):
        if "map" in host.topics:
            host.message("map", tick / 10)
    return host


def test_nobody_is_asked_before_it_is_due_but_for_a_process_that_ends() -> None:
    host = fed()
    assert "ok(map)" in (said(host, 2.0) or ())
    assert said(host, 2.01) is None
    assert "not running(mapper)" in (said(host, 2.02, ALL - {"mapper"}) or ())


@pytest.mark.parametrize(
    ("how", "says"), [("says-bad", "not ok(map)"), ("says-good", "ok(map)"), ("dead", None)]
)
def test_a_faulty_observer_is_faulty_from_when_it_is(how: str, says: str | None) -> None:
    host = fed(Blind("map", how))
    assert "ok(map)" in (said(host, 2.0) or ())
    host.faulty = True
    after = {literal for literal in said(host, 5.0) or () if "map)" in literal}
    assert after == ({says} if says else set())
    assert "not ok(scan)" in (said(host, 6.0) or ())  # the others are as they were


def test_a_missing_observer_watches_nothing() -> None:
    assert "map" not in fed(Blind("map", "missing")).topics


def test_each_host_has_its_own_and_together_they_have_all() -> None:
    anatomy = find_robot("humanoid").anatomy
    hosts = [HostObservers(anatomy, host, FAST, 0.0) for host in anatomy.hosts]
    assert len(hosts) == 3
    topics = [topic for host in hosts for topic in host.topics]
    assert sorted(topics) == sorted(topic.name for topic in anatomy.topics.values() if topic.observed)
    on = dict.fromkeys(anatomy.devices, True)
    found = [host.check(1.0, frozenset(anatomy.nodes), on) for host in hosts]
    literals = {str(literal) for each in found if each for literal in each[1]}
    assert {f"on({device})" for device in anatomy.devices} <= literals
    assert {f"running({node})" for node in anatomy.nodes} <= literals
