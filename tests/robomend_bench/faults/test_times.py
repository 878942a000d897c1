"""Where the time from detection to repaired goes: each moment has one part, and they add up."""

from __future__ import annotations

import pytest
from tests.robomend_bench.faults.small import MODEL, ROBOT, with_faults

from robomend_bench.faults.anatomy import read_anatomy
from robomend_bench.faults.condition import HEALTHY, Act, abnormal, after
from robomend_bench.faults.kinds import Fault
from robomend_bench.faults.observing import PRESETS
from robomend_bench.faults.record import SECOND_EAR, Acted, Arrived, Diagnosed, Record, RepairSeen, Trial
from robomend_bench.faults.robot import find_robot
from robomend_bench.faults.scoring import score
from robomend_bench.faults.standins import play_with
from robomend_bench.faults.stretches import STRETCHES
from robomend_bench.faults.times import Part, where_time_goes
from robomend_bench.faults.trial import Terms
from robomend_client.literals import Literal, fails, holds


def seen(at_s: float, state: str, round_: int = 1) -> RepairSeen:
    return RepairSeen(at_s, "r-1", state, ("mapper",), round_, "", ())


def acted(at_s: float, name: str, done_s: float) -> Acted:
    return Acted(at_s, Act(name, ("mapper",)), "agent", 0, done_s=done_s)


def hung_mapper() -> Record:
    """Return the record of a hung node that is restarted twice, the first time in vain."""
    hung, stopped = with_faults(("mapper", "hung")), with_faults(("mapper", "dead"))
    record = Record(Trial("small", "hung-node", 1, 1), "fast", end_s=20.0)
    record.faults = [(0.0, Fault("mapper", "hung"))]
    record.states = [(0.0, hung), (2.0, stopped), (2.5, hung), (7.0, stopped), (7.4, HEALTHY)]
    record.acts = [
        acted(1.9, "stop_node", 2.0),
        acted(2.3, "start_node", 2.5),
        acted(6.9, "stop_node", 7.0),
        acted(7.1, "start_node", 7.4),
    ]
    record.repairs = [
        seen(1.2, "waiting"),
        seen(1.7, "planning"),
        seen(1.8, "running"),
        seen(6.5, "verifying"),
        seen(6.7, "planning", 2),
        seen(6.8, "running", 2),
        seen(9.0, "verifying", 2),
        seen(9.1, "repaired", 2),
    ]
    record.diagnoses = [Diagnosed(-1.0, ((),)), Diagnosed(1.0, (("mapper",),)), Diagnosed(8.8, ((),))]
    well = [literal for literal in ROBOT.healthy if literal.atom.predicate != "on"]
    silent = (fails("ok", "map"), fails("ok", "path"))
    runs = holds("running", "mapper")
    back = (holds("ok", "map"), holds("ok", "path"))
    told: list[tuple[float, tuple[Literal, ...]]] = [
        (-1.0, tuple(well)),
        (1.0, silent[:1]),
        (3.0, silent[1:]),
        (7.5, (runs,)),
        (8.7, back),
    ]
    record.said = told
    record.silences = [("map", -0.1, 7.9), ("path", 0.2, 8.0)]
    return record


def test_every_part_has_its_moments_and_nothing_is_left_over() -> None:
    found = where_time_goes(hung_mapper(), ROBOT, 1.0, 9.1)
    wanted = {
        Part.BEGINS: 0.0,
        Part.DECIDES: 0.3,
        Part.ACTS: 0.1 + 0.2 + 0.1 + 0.3,
        Part.BETWEEN: 0.1,
        Part.ROBOT: 0.6,  # until both topics are there again
        Part.OBSERVERS: 0.9 + 0.3 + 0.5 + 0.1 + 0.7,  # `path` is told late, then who has stopped, and is back
        Part.STAYS: 0.0,
        Part.PASSES: 0.0,
        Part.MISSING: 3.5,  # nothing more is to come
        Part.CONCLUDES: 0.4,
    }
    assert found == pytest.approx(wanted)
    assert sum(found.values()) == pytest.approx(8.1)


def test_what_has_not_arrived_was_taken_back_or_has_lapsed_is_not_told() -> None:
    record = Record(Trial("small", "hung-node", 1, 1), "fast")
    good, bad, other = holds("ok", "map"), fails("ok", "map"), holds("ok", "path")
    record.arrived = [
        Arrived(-3.0, "one", (good, other), (), 5.0),
        Arrived(1.0, "one", (bad,), (), 5.0),
        Arrived(1.5, SECOND_EAR, (fails("ok", "path"),), (), 5.0),
        Arrived(3.0, "one", (), (bad.atom,), 5.0),
        Arrived(4.0, "one", (good,), (), 1.0),
    ]
    record.said = [(0.5, (bad,)), (2.5, (good,))]
    ok = good.atom
    assert [(at_s, held) for at_s, held in record.told() if held] == [
        (-3.0, {ok: True, other.atom: True}),
        (1.0, {ok: False, other.atom: True}),
        (2.0, {ok: False}),
        (4.0, {ok: True}),
    ]
    assert record.told()[-1] == (5.0, {})


def test_while_a_device_boots_whose_driver_must_be_started_nothing_can_be_back() -> None:
    robot = read_anatomy(MODEL, {"devices": {"lidar": {"boot_s": 20.0}}})
    off = with_faults(("lidar", "off"), anatomy=robot)
    on = after(robot, off, Act("power_up", ("lidar",)))[0]
    assert dict(on).keys() == {"driver"}
    record = hung_mapper()
    record.states = [(0.0, off), (2.0, on)]
    record.acts, record.repairs = [], [seen(1.2, "waiting")]
    odd = {literal.atom: literal for literal in abnormal(robot, on)}
    record.said = [(0.5, tuple(odd.get(each.atom, each) for each in robot.healthy))]
    found = where_time_goes(record, robot, 5.0, 30.0)
    assert (found[Part.ROBOT], found[Part.DECIDES]) == pytest.approx((17.0, 8.0))


def test_what_is_right_again_must_stay_so_for_as_long_as_its_observer_needs_to_see_it_fail() -> None:
    half = with_faults(("mapper", "half-rate"))
    record = hung_mapper()
    record.states = [(0.0, half), (6.9, with_faults(("mapper", "dead"))), (7.0, HEALTHY)]  # it was restarted
    record.acts, record.silences = [], []
    record.repairs = [seen(1.2, "running"), seen(7.5, "verifying")]
    record.said = [(-1.0, tuple(ROBOT.healthy))]
    found = where_time_goes(record, ROBOT, 7.0, 15.0)
    rates = [
        PRESETS["fast"].of(t.rate_hz, t.tolerance_hz) for t in (ROBOT.topics["map"], ROBOT.topics["path"])
    ]
    needs_s = max(rate.first_verdict_s + rate.check_s for rate in rates)
    assert needs_s > 1.0
    assert found[Part.STAYS] == pytest.approx(needs_s)
    assert found[Part.CONCLUDES] == pytest.approx(8.0 - needs_s)


@pytest.mark.parametrize("trial", ["base/hung-node/1.1", "underwater/feed/1.2", "loops/loop/1.3"])
def test_the_parts_of_a_trial_are_in_its_score_and_add_up(trial: str) -> None:
    robot, cls, _ = trial.split("/")
    found = score(play_with("perfect", Trial(robot, cls, 1, 1), Terms("fast")), find_robot(robot))
    assert found.repaired_s is not None
    assert sum(found.parts.values()) == pytest.approx(found.repaired_s)
    assert found.parts["acts"] > 0.1
    assert found.parts["missing effect"] == 0  # it knows what helps


def test_a_trial_that_is_not_repaired_has_no_parts() -> None:
    idle = score(play_with("idle", Trial("base", "off", 1, 1), Terms("fast")), find_robot("base"))
    still = score(
        play_with("idle", Trial("base", STRETCHES[0].name, 1, 1), Terms("fast")), find_robot("base")
    )
    assert idle.parts == still.parts == {}
