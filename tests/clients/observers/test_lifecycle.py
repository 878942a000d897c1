"""The state of a node with a lifecycle, of which only changes are told."""

from __future__ import annotations

from itertools import pairwise

from tests.clients.observers.driving import values

from robomend_client.observers import Change, Driver, Publishers, ns
from robomend_client.observers.lifecycle import LifecycleObserver, suggested

SOURCE = "camera/transition_event:start_state.label,goal_state.label"
BAD, GOOD = "not ok(lifecycle,camera)", "ok(lifecycle,camera)"


class Camera:
    def __init__(self) -> None:
        self.driver = Driver([LifecycleObserver("ok(lifecycle,camera)")], 0)

    def moves(self, at_s: float, *states: str) -> list[Change]:
        changes = list(self.driver.advance(ns(at_s)))
        for before, state in pairwise(states):
            value = {"start_state.label": before, "goal_state.label": state}
            changes += self.driver.sample(SOURCE, ns(at_s), value, ns(at_s))
        return changes

    def up(self, at_s: float) -> list[Change]:
        return self.moves(at_s, "unconfigured", "configuring", "inactive", "activating", "active")

    def until(self, at_s: float) -> list[Change]:
        return list(self.driver.advance(ns(at_s)))

    @property
    def reading(self) -> str:
        return str(self.driver.standing()[0].reading)


def test_it_is_unknown_until_a_change_is_heard() -> None:
    camera = Camera()
    assert camera.until(600) == []
    assert values(camera.up(601)) == [GOOD]
    assert camera.reading == "active"
    assert camera.until(900) == []


def test_coming_up_takes_its_time_and_is_bad_when_it_takes_longer() -> None:
    camera = Camera()
    assert camera.moves(1, "unconfigured", "configuring", "inactive") == []
    assert camera.until(8) == []
    assert values(camera.moves(9, "inactive", "activating", "active")) == [GOOD]
    camera = Camera()
    camera.moves(1, "unconfigured", "configuring", "inactive")
    assert values(camera.until(11.1)) == [BAD]
    assert camera.reading == "inactive, not active within 10 s"


def test_a_node_that_is_gone_has_no_state_until_it_is_heard_again() -> None:
    camera = Camera()
    camera.up(1)
    assert [one.value for one in camera.driver.sample(SOURCE, ns(2), Publishers(()), ns(2))] == [None]
    assert camera.driver.sample(SOURCE, ns(3), Publishers(("/camera",)), ns(3)) == []
    assert values(camera.up(4)) == [GOOD]


def test_a_topic_of_transitions_suggests_it() -> None:
    assert suggested("/a/camera/transition_event", "lifecycle_msgs/TransitionEvent") == {
        "ok(lifecycle,a/camera)": {"kind": "lifecycle", "node": "a/camera"}
    }
    assert suggested("/camera/events", "lifecycle_msgs/TransitionEvent") == {}
