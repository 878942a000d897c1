"""The physics of faults and acts, without times."""

from __future__ import annotations

import pytest
from tests.robomend_bench.faults.small import ROBOT, odd, with_faults

from robomend_bench.faults.anatomy import Anatomy, read_anatomy
from robomend_bench.faults.condition import HEALTHY, Act, State, after, broken, observed
from robomend_client.actions import FAILED, NO_PROGRAM, OK

FED = read_anatomy(
    {
        "hardware": {
            "rail": {"channel": 1},
            "cam": {"channel": 3, "fed_by": ["rail"]},
            "spare": {"channel": 4},
        },
        "nodes": {
            "cam_driver": {"drives": ["cam"], "publishes": {"image": []}},
            "viewer": {"publishes": {"view": ["image"]}, "tied_to": ["cam_driver"]},
        },
    },
    {"devices": {"cam": {"spare": "spare", "bus": "usb"}}},
)


def do(anatomy: Anatomy, state: State, *acts: tuple[str, ...]) -> State:
    for name, *parameters in acts:
        state, code = after(anatomy, state, Act(name, tuple(parameters)))
        assert code == OK
    return state


def test_a_healthy_robot_shows_every_literal_positive() -> None:
    assert observed(ROBOT, HEALTHY) == ROBOT.healthy
    assert {str(literal) for literal in ROBOT.healthy} >= {"on(lidar)", "running(mapper)", "ok(path)"}


def test_silence_goes_down_the_chain_and_no_further() -> None:
    assert odd(ROBOT, with_faults(("mapper", "hung"))) == {"not ok(map)", "not ok(path)"}


def test_a_loop_is_silent_as_a_whole() -> None:
    assert ROBOT.loops == {"estimator", "controller"}
    assert odd(ROBOT, with_faults(("estimator", "dead"))) == {
        "not running(estimator)",
        "not ok(state)",
        "not ok(command)",
    }


def test_half_the_rate_is_one_topic_s_own_and_feeds_the_rest() -> None:
    assert odd(ROBOT, with_faults(("driver", "half-rate"))) == {"not ok(scan)"}


def test_a_device_that_was_off_leaves_its_driver_with_a_dead_connection() -> None:
    state = do(ROBOT, with_faults(("lidar", "off")), ("power_up", "lidar"))
    assert odd(ROBOT, state) == {"not ok(scan)", "not ok(map)", "not ok(path)"}
    assert broken(ROBOT, state) == {"driver"}
    assert do(ROBOT, state, ("stop_node", "driver"), ("start_node", "driver")) == HEALTHY


def test_a_driver_that_starts_while_its_device_is_off_connects_when_it_comes() -> None:
    state = with_faults(("lidar", "off"))
    assert (
        do(ROBOT, state, ("stop_node", "driver"), ("start_node", "driver"), ("power_up", "lidar")) == HEALTHY
    )


def test_a_hung_device_needs_a_power_cycle_and_a_broken_one_stays_broken() -> None:
    cycle = (("shutdown", "lidar"), ("power_up", "lidar"), ("stop_node", "driver"), ("start_node", "driver"))
    assert do(ROBOT, with_faults(("lidar", "hung")), *cycle) == HEALTHY
    assert broken(ROBOT, do(ROBOT, with_faults(("lidar", "broken")), *cycle)) == {"lidar"}


def test_a_relay_that_sticks_answers_so() -> None:
    state = with_faults(("lidar", "off for ever"))
    assert after(ROBOT, state, Act("power_up", ("lidar",))) == (state, FAILED)


@pytest.mark.parametrize(
    ("kind", "starts"), [("dead, one mute successor", 2), ("dead, two mute successors", 3)]
)
def test_mute_successors_are_used_up_one_after_the_other(kind: str, starts: int) -> None:
    state = with_faults(("mapper", kind))
    for number in range(starts):
        assert "not ok(map)" in odd(ROBOT, state)
        if number:
            state = do(ROBOT, state, ("stop_node", "mapper"))
        state = do(ROBOT, state, ("start_node", "mapper"))
    assert state == HEALTHY


def test_a_program_that_does_not_start_answers_so_and_is_not_running() -> None:
    state = with_faults(("mapper", "dead, does not start"))
    assert after(ROBOT, state, Act("start_node", ("mapper",))) == (state, NO_PROGRAM)


def test_mute_for_ever_is_mute_after_each_start() -> None:
    state = with_faults(("mapper", "hung, mute for ever"))
    assert do(ROBOT, state, ("stop_node", "mapper"), ("start_node", "mapper")) == state


def test_a_relay_tells_its_position_and_a_feed_takes_what_it_feeds() -> None:
    state = with_faults(("rail", "off"), anatomy=FED)
    assert odd(FED, state) == {"not on(rail)", "not ok(image)", "not ok(view)"}


def test_what_is_tied_to_a_node_must_be_restarted_after_it() -> None:
    state = do(FED, HEALTHY, ("stop_node", "cam_driver"), ("start_node", "cam_driver"))
    assert odd(FED, state) == {"not ok(view)"}
    assert do(FED, state, ("stop_node", "viewer"), ("start_node", "viewer")) == HEALTHY


def test_a_spare_stands_in_once_the_driver_is_restarted() -> None:
    state = do(FED, with_faults(("cam", "broken"), anatomy=FED), ("switch_to_spare", "cam", "spare"))
    state = do(FED, state, ("stop_node", "cam_driver"), ("start_node", "cam_driver"))
    assert odd(FED, state) == {"not ok(view)"}  # tied to the driver
    assert broken(FED, state) == {"viewer"}


def test_a_reset_of_the_bus_wakes_what_hangs_on_it() -> None:
    state = do(FED, with_faults(("cam", "hung"), anatomy=FED), ("reset_bus", "usb"))
    assert broken(FED, state) == {"cam_driver"}
