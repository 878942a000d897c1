"""What follows from what DDS has discovered."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robomend_client.bridges.ros2.cdr import Entities, NodeEntities
from robomend_client.bridges.ros2.discovered import SOMEBODY, Discovered, Endpoint, Participant
from robomend_client.bridges.ros2.node import choose
from robomend_client.bridges.ros2.stamps import MOST_LATE_NS, Ages

STRING, SCAN = "std_msgs::msg::dds_::String_", "sensor_msgs::msg::dds_::LaserScan_"
LASER, MAPPER = b"laser".ljust(16), b"mapper".ljust(16)
OUT = Endpoint(b"out".ljust(16), LASER, "rt/scan", SCAN, writes=True, handle=7)
IN = Endpoint(b"in".ljust(16), MAPPER, "rt/scan", SCAN, writes=False)


def robot() -> Discovered:
    """A laser and a mapper that listens to it."""
    found = Discovered(own=b"own".ljust(16))
    for key in (LASER, MAPPER):
        found.participant(Participant(key))
    found.told(Entities(LASER, (NodeEntities("/laser", (), (OUT.key,)),)))
    found.told(Entities(MAPPER, (NodeEntities("/mapper", (IN.key,)), NodeEntities("/other"))))
    found.endpoint(OUT)
    found.endpoint(IN)
    return found


def test_a_graph_names_who_publishes_and_who_listens() -> None:
    found = robot()
    found.endpoint(replace(IN, key=b"rq".ljust(16), topic="rq/mapper/saveRequest", type="x::srv::dds_::S_"))
    found.endpoint(replace(OUT, key=b"a".ljust(16), topic="rt/arm/_action/feedback", handle=8))
    graph = found.graph()
    assert graph.publishers == {"/scan": {"/laser"}}
    assert graph.subscribers == {"/scan": {"/mapper"}}
    assert graph.types == {"/scan": "sensor_msgs/LaserScan"}
    assert graph.services == {"/mapper/save": {SOMEBODY}}  # one of two nodes: nobody has said which


def test_whose_a_topic_is_may_still_be_told() -> None:
    found = robot()
    found.endpoint(replace(OUT, key=b"info".ljust(16), topic="ros_discovery_info", participant=MAPPER))
    assert not found.unnamed  # that one is nobody's, for ever
    late = replace(OUT, key=b"late".ljust(16), topic="rt/map", participant=MAPPER)
    found.endpoint(late)
    assert found.unnamed
    found.told(Entities(MAPPER, (NodeEntities("/mapper", (IN.key,), (late.key,)), NodeEntities("/other"))))
    assert not found.unnamed


def test_it_is_unknown_whether_nodes_run_whose_participant_went_without_a_word() -> None:
    found = robot()
    found.participant_gone(MAPPER)
    assert found.nodes({}) == {"/laser": True, "/mapper": None, "/other": None}
    assert found.nodes({MAPPER: True}) == {"/laser": True, "/mapper": True, "/other": True}
    found.told(Entities(LASER, (NodeEntities("/laser"), NodeEntities("/other"))))  # it was started elsewhere
    assert found.nodes({}) == {"/laser": True, "/mapper": None, "/other": True}
    assert not found.returned
    found.participant(Participant(MAPPER))
    assert (found.returned, found.nodes({})["/mapper"]) == ({MAPPER}, None)  # there again, and silent
    found.told(Entities(MAPPER, (NodeEntities("/mapper"),)))
    assert not found.returned
    assert found.nodes({}) == {"/laser": True, "/mapper": True, "/other": True}


def test_of_two_nodes_with_one_name_one_that_runs_is_enough() -> None:
    found = robot()
    found.participant(Participant(b"again".ljust(16)))
    found.told(Entities(b"again".ljust(16), (NodeEntities("/laser"),)))
    assert found.nodes({LASER: False})["/laser"] is True


def test_whoever_has_not_told_its_nodes_yet_is_waited_for() -> None:
    found = robot()
    assert not found.untold
    found.participant(Participant(b"dds".ljust(16), is_ros=False))
    assert not found.untold
    found.participant(Participant(b"new".ljust(16)))
    assert found.untold


def test_a_sample_leads_to_its_writer_until_that_has_gone() -> None:
    found = robot()
    assert found.writer(7) == OUT
    assert found.node_of(OUT) == "/laser"
    found.endpoint_gone(OUT.key)
    assert found.writer(7) is None
    assert not found.is_named(replace(OUT, key=b"", participant=b""))  # told of nobody


@pytest.mark.parametrize(
    ("offered", "asked", "why"),
    [
        ({}, {}, ""),
        ({"reliable": False}, {"reliable": False}, ""),
        ({"reliable": False}, {}, "/laser publishes best effort, /mapper asks for reliable: no message"),
        ({}, {"durability": 1}, "publishes volatile, /mapper asks for transient local"),
        ({"type": STRING}, {}, "publishes std_msgs/String, /mapper asks for sensor_msgs/LaserScan"),
        ({}, {"deadline_ns": 10**8}, "publishes no deadline, /mapper asks for one of 0.1 s"),
        ({"deadline_ns": 10**8}, {"deadline_ns": 2 * 10**8}, ""),
    ],
)  # fmt: skip
def test_a_reader_that_gets_nothing_from_a_writer_is_named(
    offered: dict[str, object], asked: dict[str, object], why: str
) -> None:
    found = robot()
    found.endpoint(replace(OUT, **offered))  # type: ignore[arg-type]  # one field or another
    found.endpoint(replace(IN, **asked))  # type: ignore[arg-type]  # the same
    assert set(found.mismatches()) == ({"/scan"} if why else set())
    assert why in found.mismatches().get("/scan", "")


def test_our_own_reader_takes_what_the_writers_offer() -> None:
    latched = replace(OUT, durability=1)
    assert choose([OUT]) == (SCAN, False)
    assert choose([latched]) == (SCAN, True)
    assert choose([latched, OUT]) == (SCAN, False)  # else one of the two would not be heard
    assert choose([latched, replace(OUT, type=STRING)]) == (STRING, False)  # the newest says what it is now


# --- stamps ------------------------------------------------------------------------------------------------


def test_a_samples_age_is_its_delay_beyond_the_least_one_whatever_the_writers_clock_says() -> None:
    ages = Ages()
    hour_ns = 3600 * 10**9
    for made_ns, delay_ns in ((0, 5_000_000), (10**8, 1_000_000), (2 * 10**8, 16_000_000)):
        age_ns = ages.age_ns(made_ns - hour_ns, made_ns + delay_ns)
    assert 14_000_000 < age_ns <= 15_000_000


def test_a_clock_that_is_set_makes_no_sample_old() -> None:
    ages = Ages()
    ages.age_ns(0, 10**9)
    assert ages.age_ns(-5 * 10**9, 10**9 + 10**8) == 0  # set back by 5 s
    assert ages.age_ns(10**12, 10**9 + 2 * 10**8) == 0  # and far ahead
    assert MOST_LATE_NS < 2 * 10**8


def test_clocks_that_drift_apart_make_no_sample_old() -> None:
    ages = Ages()
    found = [ages.age_ns(round(at_ns * 0.9995), at_ns) for at_ns in range(0, 3600 * 10**9, 10**9)]
    assert max(found) < 10_000_000
