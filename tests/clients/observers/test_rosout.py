"""Lines of a node's log: ERROR and FATAL are a fault while they come, whatever is in them."""

from __future__ import annotations

from typing import Any

import pytest
from tests.clients.observers.driving import values

from robomend_client.observers import Change, Driver, ns
from robomend_client.observers.rosout import ROSOUT, LogRules, RosoutObserver, suggested
from robomend_client.readings import Symptom


class Log:
    """The log of a robot, under an observer of one node."""

    def __init__(self, **keys: Any) -> None:
        self.driver = Driver([RosoutObserver("ok(log,camera)", **keys)], 0)

    def line(self, at_s: float, level: int, msg: object = "x", name: str = "camera") -> list[Change]:
        now_ns = ns(at_s)
        changes = list(self.driver.advance(now_ns))
        changes += self.driver.sample(ROSOUT, now_ns, {"level": level, "name": name, "msg": msg}, now_ns)
        return changes

    @property
    def reading(self) -> Any:
        return self.driver.standing()[0].reading


@pytest.mark.parametrize("level", [16, 40])
def test_a_line_is_a_fault_at_once_and_over_after_a_while(level: int) -> None:
    log = Log()
    assert values(log.line(1, level, "cannot open /dev/video0")) == ["not ok(log,camera)"]
    assert log.reading.symptom is Symptom.SELF_REPORT
    assert str(log.reading) == f"{'FATAL' if level == 16 else 'ERROR'}: cannot open /dev/video0"
    assert values(log.driver.advance(ns(10.9))) == []
    assert values(log.driver.advance(ns(11.1))) == ["ok(log,camera)"]
    assert str(log.reading) == "no ERROR for 10 s"


@pytest.mark.parametrize(
    "text",
    [
        "Received comm state PREEMPTING when in simple state DONE with SimpleActionClient in NS /dock",
        "Got a feedback callback on a goal handle that we're not tracking. /a-1-2.3 vs /a-2-2.4",
        "To transition to a cancelled state, the goal must be in a pending, recalling, active, or preempting "
        "state, it is currently in state: 3",
    ],
)
def test_what_actionlib_logs_when_a_goal_is_cancelled_is_no_fault(text: str) -> None:
    log = Log(ignore=["harmless"])
    found = [change for n in range(300) for change in log.line(n / 10, 8, text)]
    assert values(found) == ["ok(log,camera)"]
    assert values(log.line(31, 8, f"{text[:20]} is broken")) == ["not ok(log,camera)"]


def test_first_and_last_line_are_told_with_their_number() -> None:
    log = Log()
    for n in range(4):
        log.line(1 + n, 40, f"lost frame {n}")
    assert str(log.reading) == "4 lines in 3 s, first ERROR: lost frame 0, last ERROR: lost frame 3"
    log.line(30, 40, "again")
    assert str(log.reading) == "ERROR: again"


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("camera", True),
        ("/camera", True),
        ("camera.driver", True),
        ("camera2", False),
        ("other.camera", False),
    ],
)
def test_a_child_of_the_nodes_logger_is_its_own_and_others_are_not(name: str, ours: bool) -> None:
    assert bool(Log().line(1, 40, name=name)) is ours


def test_lines_that_mean_nothing_are_left_out_and_several_may_be_asked_for() -> None:
    log = Log(ignore=["timed out*again", "harmless"])
    assert not log.line(1, 40, "the camera timed out, trying again")
    assert not log.line(1, 40, "harmless")
    assert log.line(1, 40, "again: timed out")
    log = Log(rules=LogRules(lines=3, hold_s=5))
    assert not [*log.line(1, 40), *log.line(2, 40), *log.line(8, 40), *log.line(9, 40)][1:]
    assert values(log.line(10, 40)) == ["not ok(log,camera)"]
    assert values(Log(rules=LogRules(level="fatal")).line(1, 40)) == []


@pytest.mark.parametrize(
    "value", [None, 4, "x", {"level": 40}, {"level": None, "name": "camera", "msg": "x"}]
)
def test_what_is_no_line_makes_it_unknown(value: object) -> None:
    log = Log()
    log.line(1, 40)
    assert [one.value for one in log.driver.sample(ROSOUT, ns(2), value, ns(2))] == [None]


def test_the_robots_log_suggests_one_for_each_node() -> None:
    for kind in ("rosgraph_msgs/Log", "rcl_interfaces/Log"):
        assert suggested("/rosout", kind, ["/a/camera"]) == {
            "ok(log,a/camera)": {"kind": "rosout", "node": "a/camera"}
        }
    assert suggested("/rosout_agg", "rosgraph_msgs/Log", ["/camera"]) == {}
