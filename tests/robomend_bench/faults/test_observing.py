"""The observers of one host, and what is the matter with one of them."""

from __future__ import annotations

import pytest
from tests.robomend_bench.faults.small import ROBOT

from robomend_bench.faults.classes import Blind
from robomend_bench.faults.observing import PRESETS, HostObservers, ns
from robomend_bench.faults.robot import find_robot
from robomend_client.literals import Atom
from robomend_client.observers import Contact

ALL = frozenset(ROBOT.nodes)
FAST = PRESETS["fast"]


def said(host: HostObservers, at_s: float, running: frozenset[str] = ALL) -> set[str]:
    """Return what they hold, and what they say has changed."""
    changes = host.check(at_s, running, {})
    return {str(verdict.literal) for verdict in host.standing()} | {str(change.value) for change in changes}


def fed(blind: Blind | None = None) -> HostObservers:
    """Return observers that have heard two seconds of a map at 10 Hz."""
    host = HostObservers(ROBOT, None, FAST, 0.0, blind)
    for tick in range(20):
        if "map" in host.topics:
            host.message("map", tick / 10)
    return host


def test_a_process_that_ends_is_told_at_once_and_a_topic_at_its_tick() -> None:
    host = fed()
    assert "ok(map)" in said(host, 2.0)
    assert [str(c.value) for c in host.check(2.02, ALL - {"mapper"}, {})] == ["not running(mapper)"]
    assert [(str(c.value), c.time_ns) for c in host.check(3.0, ALL - {"mapper"}, {})] == [
        ("not ok(map)", ns(2.4))
    ]


def test_messages_count_when_they_were_due_whenever_they_are_handed_in() -> None:
    host = fed()
    assert "ok(map)" in said(host, 1.95)
    for at_s in (2.2, 2.1, 2.0, 2.3):
        host.message("map", at_s)
    assert [str(c.value) for c in host.check(2.35, ALL, {})] == []


def test_an_agent_that_was_held_up_does_not_take_it_for_silence() -> None:
    host = fed()
    assert "ok(map)" in said(host, 2.0)
    host.lapse(7.0)
    for _ in range(50):
        host.message("map", 7.0)
    for tick in range(10):
        host.message("map", 7.05 + tick / 10)
    assert [c for c in host.check(8.0, ALL, {}) if c.atom == Atom("ok", ("map",))] == []


def test_what_was_heard_once_of_a_latched_topic_is_known_after_its_agent_was_held_up() -> None:
    host = HostObservers(find_robot("cart").anatomy, None, FAST, 0.0)
    host.message("map", 0.5)
    assert "ok(map)" in said(host, 1.0)
    host.lapse(9.0)
    assert "ok(map)" in said(host, 10.0)


def test_what_a_bridge_does_not_hear_is_unknown_though_a_message_was_on_its_way_when_it_left() -> None:
    host = fed()
    host.message("map", 2.0)
    assert "ok(map)" in said(host, 2.01)
    host.message("map", 2.1)
    host.look(Contact.LOST, 2.05)
    changes = [change for at_s in (2.2, 2.6, 3.2, 6.0) for change in host.check(at_s, ALL, {})]
    assert [c.value for c in changes if c.atom == Atom("ok", ("map",))] == [None]


def test_asked_to_settle_they_judge_anew() -> None:
    host = fed()
    assert "ok(map)" in said(host, 2.0)
    host.settle(3, [Atom("ok", ("map",))])
    (settled,) = [c for c in host.check(3.0, ALL, {}) if c.settled == 3]
    assert (str(settled.value), settled.time_ns) == ("not ok(map)", ns(2.5))


def test_asked_to_settle_relays_that_did_not_move_are_told_again() -> None:
    anatomy = find_robot("humanoid").anatomy
    on = dict.fromkeys(anatomy.devices, True)
    running = frozenset(anatomy.nodes)
    host = HostObservers(anatomy, anatomy.hosts[0], FAST, 0.0)
    first = host.check(1.0, running, on)
    relays = [change.atom for change in first if change.atom.predicate == "on"]
    assert relays
    host.settle(3, relays)
    later = [change for at_s in (1.05, 1.1, 1.15, 1.2, 1.3) for change in host.check(at_s, running, on)]
    assert [(c.atom, c.settled) for c in later if c.value is not None] == [(atom, 3) for atom in relays]
    assert {v.literal.atom for v in host.standing()} >= set(relays)


@pytest.mark.parametrize(
    ("how", "says"), [("says-bad", "not ok(map)"), ("says-good", "ok(map)"), ("dead", None)]
)
def test_a_faulty_observer_is_faulty_from_when_it_is(how: str, says: str | None) -> None:
    host = fed(Blind("map", how))
    assert "ok(map)" in said(host, 2.0)
    host.faulty = True
    host.check(5.0, ALL, {})
    after = {str(verdict.literal) for verdict in host.standing()}
    assert {literal for literal in after if "map)" in literal} == ({says} if says else set())
    assert "not ok(scan)" in after  # the others are as they were


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
    literals = {str(change.value) for each in found for change in each}
    assert {f"on({device})" for device in anatomy.devices} <= literals
    assert {f"running({node})" for node in anatomy.nodes} <= literals
