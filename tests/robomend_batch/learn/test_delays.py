"""Which topic answers which, from times alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robomend_batch.learn.delays import DelayFound, learn_delays
from robomend_client.observers import SECOND

Times = NDArray[np.int64]
CHANCE = np.random.default_rng(5)


def timer(hz: float, jitter: float = 0.03, offset: float = 0.0, seconds: float = 600) -> Times:
    """Return the times of a node that sends by a clock."""
    times = offset + np.arange(0.1, seconds, 1 / hz)
    return (np.sort(times + jitter / hz * CHANCE.standard_t(3, len(times))) * SECOND).astype(np.int64)


def answer(asked: Times, seconds: float, spread: float = 0.3) -> Times:
    """Return answers that take about so long."""
    return np.sort(asked + (seconds * CHANCE.lognormal(0, spread, len(asked)) * SECOND).astype(np.int64))


def learn(**topics: Times) -> dict[str, DelayFound]:
    pieces = {name: [times] for name, times in topics.items()}
    found, _ = learn_delays(pieces, {name: f"/{name}_node" for name in topics}, 0.2, 0.01)
    return {one.out_topic: one for one in found}


def test_one_answer_to_several_messages_is_one() -> None:
    scan = timer(10)
    found = learn(scan=scan, map=answer(scan[::5], 0.02))
    assert found["map"].in_topic == "scan"
    assert 0.4 < found["map"].within.usual < 0.5  # since the oldest of five


def test_an_answer_to_an_answer_is_no_answer_to_the_first() -> None:
    scan = timer(10)
    first = answer(scan, 0.01)
    found = learn(scan=scan, map=first, path=answer(first, 0.01))
    assert (found["map"].in_topic, found["map"].more) == ("scan", ())
    assert (found["path"].in_topic, found["path"].more) == ("map", ())


def test_two_answers_to_one_topic_do_not_answer_each_other() -> None:
    scan = timer(10)
    found = learn(scan=scan, map=answer(scan, 0.005), obstacles=answer(scan, 0.03))
    assert (found["map"].in_topic, found["map"].more) == ("scan", ())
    assert (found["obstacles"].in_topic, found["obstacles"].more) == ("scan", ())


def test_a_node_does_not_answer_itself() -> None:
    scan = timer(10)
    pieces = {"scan": [scan], "cloud": [answer(scan, 0.001)]}
    assert learn_delays(pieces, {"scan": "/lidar", "cloud": "/lidar"}, 0.2, 0.01) == ([], [])


def test_topics_that_an_unknown_node_sends_together_do_not_answer_each_other() -> None:
    image = timer(10)
    pieces = {"image": [image], "camera_info": [answer(image, 0.0003)], "faces": [answer(image, 0.02)]}
    nodes = {name: f"/publisher_of_{name}" for name in pieces}
    delays, together = learn_delays(pieces, nodes, 0.2, 0.01, unnamed=pieces)
    assert [one.out_topic for one in delays] == ["faces"]
    assert together == [("image", "camera_info")]
    delays, together = learn_delays(pieces, nodes, 0.2, 0.01, unnamed=())
    assert ([one.out_topic for one in delays], together) == (["camera_info", "faces"], [])


def test_stretches_without_messages_are_no_obstacle() -> None:
    scan = timer(10)
    empty = scan[:0]
    pieces = {"scan": [scan, empty, scan], "map": [answer(scan, 0.02), empty, answer(scan, 0.02)]}
    ((found,), _) = learn_delays(pieces, {"scan": "/lidar", "map": "/mapper"}, 0.2, 0.01)
    assert found.in_topic == "scan"
