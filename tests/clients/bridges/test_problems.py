"""What is wrong outside is told once for each place, as long as it lasts."""

from __future__ import annotations

import pytest

from robomend_client.bridges.problems import MOST_MESSAGES, Problems


def told(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]


def test_what_goes_to_and_fro_is_told_once_until_it_is_over(caplog: pytest.LogCaptureFixture) -> None:
    problems = Problems("ROS 1")
    for _ in range(3):
        problems.tell("the master", "no answer")
        problems.tell("the master", "no way leads there")
    assert told(caplog) == ["ROS 1, the master: no answer", "ROS 1, the master: no way leads there"]
    assert problems.counts["the master"] == 6
    problems.over("the master")
    problems.tell("the master", "no answer")
    assert told(caplog)[2:] == ["ROS 1, the master: no answer"]


def test_a_place_that_always_says_something_else_has_a_bound(caplog: pytest.LogCaptureFixture) -> None:
    problems = Problems("ROS 1")
    for number in range(MOST_MESSAGES + 5):
        problems.tell("/scan by /laser", f"message {number} cannot be read")
    assert len(told(caplog)) == MOST_MESSAGES


def test_bad_messages_among_good_ones_are_one_problem(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    problems = Problems("ROS 1")
    for _ in range(50):
        problems.tell("messages of /scan", "cannot be read")
        problems.over("messages of /scan", quiet_s=3600)
    assert [record.getMessage() for record in caplog.records] == ["ROS 1, messages of /scan: cannot be read"]
    problems.over("messages of /scan", quiet_s=0)
    assert caplog.records[-1].getMessage() == "ROS 1, messages of /scan: well again"


def test_what_a_peer_writes_is_one_line_of_the_log(caplog: pytest.LogCaptureFixture) -> None:
    Problems("ROS 1").tell("/scan", "it refuses: go away\n2026-01-01 INFO all is well")
    assert told(caplog) == ["ROS 1, /scan: it refuses: go away 2026-01-01 INFO all is well"]
