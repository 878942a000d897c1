"""The drafted model: what the running robot knows itself is not guessed from times, nor asked."""

from __future__ import annotations

import numpy as np

from robomend_batch.learn.delays import DelayFound
from robomend_batch.learn.gathering import Topic
from robomend_batch.learn.model import Declared, Links, draft_model, publishers_of
from robomend_batch.learn.tails import Bound
from robomend_client.ros_graph import RosGraph

ANSWER = DelayFound("map", "scan", ("odom",), 0.5, 0.03, Bound(0.1, 0.03, 0.05, 0.05, 1000), 0.1)
TALKS = {"scan": "/lidar", "odom": "/base", "map": "/mapper"}


def drafted(live: RosGraph) -> str:
    topics = {name: Topic(name, types={"std_msgs/msg/Float64"}) for name in TALKS}
    for topic in topics.values():
        topic.publishers.add(TALKS[topic.name])
        topic.times[0].append(np.arange(40) * 100_000_000)
    links = Links([ANSWER], [], live, [])
    return draft_model("r", "a log", topics, publishers_of(topics.values(), live), links, Declared())


def test_inputs_that_are_seen_from_times_alone_are_drafted_and_asked() -> None:
    text = drafted(RosGraph())
    assert "map: [odom, scan]" in text
    assert "map answers scan, odom after 30 ms" in text


def test_what_the_running_robot_says_of_a_node_is_neither_guessed_nor_asked() -> None:
    live = RosGraph({"/map": frozenset({"/mapper"})}, {"/scan": frozenset({"/mapper", "/recorder"})})
    text = drafted(live)
    assert "map: [scan]" in text
    assert "Who listens to what?" not in text


def test_a_node_that_did_not_run_then_is_guessed_and_asked() -> None:
    text = drafted(RosGraph({"/scan": frozenset({"/lidar"})}))
    assert "map: [odom, scan]" in text
    assert "Who listens to what?" in text


def test_what_never_came_is_no_input_and_cuts_a_circle() -> None:
    topics = {name: Topic(name, types={"std_msgs/msg/Float64"}) for name in TALKS}
    for topic in topics.values():
        topic.publishers.add(TALKS[topic.name])
        if topic.name != "odom":
            topic.times[0].append(np.arange(40) * 100_000_000)
    mapper, lidar = frozenset({"/mapper"}), frozenset({"/lidar"})
    live = RosGraph({"/map": mapper}, {"/scan": mapper, "/odom": mapper, "/map": lidar})
    topics["scan"].times[0] = [np.arange(400) * 100_000_000]  # goes on when maps do not come any more
    topics["map"].times[0] = [np.concatenate([np.arange(100), np.arange(300, 400)]) * 100_000_000]
    links = Links([], [], live, [])
    text = draft_model("r", "a log", topics, publishers_of(topics.values(), live), links, Declared())
    assert "map: [scan]" in text
    assert "scan: []" in text
