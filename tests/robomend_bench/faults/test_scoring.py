"""The score, on records written by hand and on those of the stand-ins."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest
from tests.robomend_bench.faults.small import ROBOT, with_faults

from robomend_bench.faults.classes import CLASSES
from robomend_bench.faults.condition import HEALTHY, Act, DeviceCondition, State
from robomend_bench.faults.field import BY_NAME
from robomend_bench.faults.kinds import Fault
from robomend_bench.faults.record import Acted, Diagnosed, Record, RepairSeen, Trial
from robomend_bench.faults.robot import Robot, find_robot, robot_names
from robomend_bench.faults.scoring import Score, repair_utility, score
from robomend_bench.faults.standins import play_with
from robomend_bench.faults.stretches import STRETCHES
from robomend_bench.faults.trial import Terms

SMALL = Robot("small", "", ROBOT)
Told = tuple[float, str, tuple[str, ...]]


def record_of(
    fault: Fault,
    states: Sequence[tuple[float, State]],
    acts: Sequence[tuple[float, str, str]] = (),
    repairs: Sequence[Told] = (),
    diagnoses: Sequence[tuple[float, tuple[tuple[str, ...], ...]]] = (),
    *,
    reason: str = "",
) -> Record:
    record = Record(Trial("small", "hung-node", 1, 1), "published", end_s=20.0)
    record.faults = [(0.0, fault)]
    record.states = list(states)
    record.acts = [Acted(at_s, Act(name, (part,)), "agent", 0) for at_s, name, part in acts]
    record.repairs = [RepairSeen(at_s, "r-1", state, bad, 1, reason, ()) for at_s, state, bad in repairs]
    record.diagnoses = [Diagnosed(-1.0, ((),)), *(Diagnosed(at_s, bads) for at_s, bads in diagnoses)]
    return record


HUNG = Fault("mapper", "hung")
STOPPED = with_faults(("mapper", "dead"))
REPAIR = ((3.1, "stop_node", "mapper"), (3.3, "start_node", "mapper"))
TRUTH = ((0.0, with_faults(("mapper", "hung"))), (3.2, STOPPED), (3.5, HEALTHY))


def test_a_repair_as_it_should_be() -> None:
    found = score(
        record_of(
            HUNG,
            TRUTH,
            REPAIR,
            [(3.0, "planning", ("mapper",)), (6.0, "repaired", ("mapper",))],
            [(2.4, (("mapper",),)), (5.9, ((),))],
        ),
        SMALL,
    )
    assert (found.right, found.told_apart, found.cause_first, found.repairable) == (True, True, True, True)
    assert (found.acts, found.best_acts, found.extra, found.wrong) == (2, 2, 0, [])
    assert found.detection_s == 2.4
    assert found.repaired_s == pytest.approx(3.6)
    assert (found.errors, found.utility) == (0, 1)
    assert 0.9 < found.points < 1


def test_an_act_on_what_only_needs_the_cause_is_wrong() -> None:
    chased = (*REPAIR, (4.0, "stop_node", "planner"), (4.2, "start_node", "planner"))
    states = (*TRUTH, (4.1, with_faults(("planner", "dead"))), (4.4, HEALTHY))
    found = score(
        record_of(
            HUNG,
            states,
            chased,
            [(3.0, "planning", ("mapper",)), (7.0, "repaired", ("planner",))],
            [(2.4, (("mapper",),)), (6.9, ((),))],
        ),
        SMALL,
    )
    # To start again what was stopped in error belongs to the error.
    assert found.wrong == ["4.00 s: stop_node(planner)", "4.20 s: start_node(planner)"]
    assert (found.right, found.extra) == (True, 2)
    assert found.points < 0.5


def test_power_cut_in_error_makes_all_that_brings_it_back_wrong() -> None:
    acts = [
        (1.0, "shutdown", "lidar"),
        (1.2, "power_up", "lidar"),
        (1.4, "stop_node", "driver"),
        (1.7, "start_node", "driver"),
        (3.0, "stop_node", "estimator"),
    ]
    fault = Fault("estimator", "hung")
    hung = with_faults(("estimator", "hung"))
    off = hung | with_faults(("lidar", "off"))
    stale = hung | (with_faults(("lidar", "off")) - {("lidar", DeviceCondition(on=False))})
    stopped = hung | with_faults(("driver", "dead"))
    states = [(0.0, hung), (1.1, off), (1.3, stale), (1.5, stopped), (1.9, hung), (3.1, HEALTHY)]
    found = score(record_of(fault, states, acts), SMALL)
    assert [each.split(": ")[1] for each in found.wrong] == [
        "shutdown(lidar)",
        "power_up(lidar)",
        "stop_node(driver)",
        "start_node(driver)",
    ]


def test_an_act_on_what_was_broken_a_moment_ago_is_not_wrong() -> None:
    def wrong(at_s: float) -> list[str]:
        again = (*REPAIR, (at_s, "stop_node", "mapper"))
        return score(record_of(HUNG, TRUTH, again), SMALL).wrong

    assert wrong(3.5 + 2.4) == []
    assert wrong(3.5 + 2.6) == ["6.10 s: stop_node(mapper)"]


@pytest.mark.parametrize(
    ("blamed", "first"),
    [
        (("mapper",), True),
        (("planner",), False),
        (("mapper", "planner"), False),
        (("mapper", "driver"), False),
        ((), False),
    ],
)
def test_the_cause_comes_first_if_nothing_else_is_blamed(blamed: tuple[str, ...], first: bool) -> None:
    record = record_of(HUNG, TRUTH[:1], [], [(3.0, "planning", blamed)], [(2.4, (blamed,))])
    assert score(record, SMALL).cause_first is first


def test_of_a_double_fault_all_that_is_old_enough_to_be_seen_must_be_blamed() -> None:
    both = with_faults(("mapper", "dead"), ("estimator", "dead"))
    for decided_s, first in ((0.1, True), (3.0, False)):
        record = record_of(Fault("mapper", "dead"), [(0.0, both)], [], [(decided_s, "planning", ("mapper",))])
        record.faults.append((0.0, Fault("estimator", "dead")))
        found = score(record, SMALL)
        assert (found.told_apart, found.cause_first) == (True, first)


def test_an_act_on_what_looks_like_the_cause_is_not_wrong_but_may_be_extra() -> None:
    hung = with_faults(("driver", "hung"))
    cycled = [
        (3.0, "shutdown", "lidar"),
        (3.2, "power_up", "lidar"),
        (3.4, "stop_node", "driver"),
        (3.6, "start_node", "driver"),
    ]
    states = [(0.0, hung), (3.0, hung | with_faults(("lidar", "off"))), (3.2, hung), (3.7, HEALTHY)]
    found = score(
        record_of(
            Fault("driver", "hung"),
            states,
            cycled,
            [(2.9, "planning", ("lidar",)), (7.0, "repaired", ("lidar",))],
            [(2.4, (("lidar",), ("driver",))), (6.9, ((),))],
        ),
        SMALL,
    )
    assert (found.told_apart, found.wrong, found.extra) == (False, [], 2)


def test_a_mute_successor_called_repaired_is_false() -> None:
    fault = Fault("mapper", "dead, one mute successor")
    states = [(0.0, with_faults(("mapper", fault.kind))), (0.5, with_faults(("mapper", "hung")))]
    found = score(
        record_of(
            fault,
            states,
            [(0.3, "start_node", "mapper")],
            [(0.1, "planning", ("mapper",)), (3.0, "repaired", ("mapper",))],
            [(0.1, (("mapper",),)), (0.6, ((),))],
        ),
        SMALL,
    )
    assert found.false_repaired == ["3.00 s: not ok(map), not ok(path) still wrong"]
    assert (found.repaired, found.right) == (False, False)
    assert found.points < -0.5


def test_a_new_fault_too_young_to_be_seen_makes_no_repair_false() -> None:
    record = record_of(
        HUNG,
        (*TRUTH, (5.5, with_faults(("driver", "hung")))),
        REPAIR,
        [(3.0, "planning", ("mapper",)), (6.0, "repaired", ("mapper",))],
        [(2.4, (("mapper",),)), (5.9, ((),))],
    )
    record.faults.append((5.5, Fault("driver", "hung")))
    assert score(record, SMALL).false_repaired == []
    record.faults[-1] = (3.0, Fault("driver", "hung"))
    assert score(record, SMALL).false_repaired == [
        "6.00 s: not ok(map), not ok(path), not ok(scan) still wrong"
    ]


@pytest.mark.parametrize(
    ("reason", "standing", "named"),
    [
        ("nothing helps lidar: look at it", (("driver",),), True),
        ("nothing helps lidar2", (("driver",),), False),
        ("nothing helps", (("lidar",), ("driver",)), True),  # as many as cannot be told apart
        ("nothing helps", (("planner",), ("mapper",), ("lidar",)), False),
    ],
)
def test_beyond_repair_the_cause_must_be_named(
    reason: str, standing: tuple[tuple[str, ...], ...], named: bool
) -> None:
    found = score(
        record_of(
            Fault("lidar", "broken"),
            [(0.0, with_faults(("lidar", "broken")))],
            [],
            [(3.0, "planning", ("driver",)), (9.0, "escalated", ("driver",))],
            [(2.4, standing)],
            reason=reason,
        ),
        SMALL,
    )
    assert (found.repairable, found.escalated, found.cause_named, found.right) == (False, True, named, named)


def test_who_does_nothing_gets_nothing_for_a_fault() -> None:
    found = score(record_of(HUNG, TRUTH[:1]), SMALL)
    assert (found.detected, found.repaired, found.right, found.points) == (False, False, False, 0.0)
    assert (found.cause_first, found.extra) == (False, None)


def test_a_fault_that_nobody_can_see_is_detected_by_saying_so() -> None:
    def detected(*unknown: tuple[float, tuple[str, ...]]) -> float | None:
        record = record_of(HUNG, TRUTH[:1])
        record.unknown = list(unknown)
        found = score(record, SMALL)
        assert found.detected is (found.detection_s is not None)
        return found.detection_s

    assert detected((0.1, ("ok(map)", "ok(scan)"))) == 0.1
    assert detected((-1.0, ("ok(map)",)), (0.2, ()), (5.0, ("ok(map)",))) == 5.0
    assert detected((-1.0, ("ok(map)",)), (0.2, ("ok(scan)",))) is None


def test_alarms_and_acts_on_a_healthy_robot_count() -> None:
    record = Record(Trial("small", "jitter", 1, 1), "published", end_s=30.0)
    assert score(record, SMALL).points == 1.0
    record.diagnoses = [Diagnosed(at_s, bads) for at_s, bads in ((1, ((),)), (2, (("a",),)), (3, (("b",),)))]
    record.diagnoses += [Diagnosed(4, ((),)), Diagnosed(5, (("a",),))]
    record.acts = [Acted(2.5, Act("stop_node", ("planner",)), "agent", 0)]
    found = score(record, SMALL)
    assert (found.group, found.alarms, found.acts) == ("healthy", 2, 1)
    assert found.as_json()["right"] is None  # it is no fault that ended wrong
    assert found.points == pytest.approx(0.3)


def test_what_was_true_a_moment_ago_is_no_false_alarm() -> None:
    def alarms(*at_s: float) -> int:
        record = Record(Trial("small", "boot", 1, 1), "published", end_s=15.0)
        record.states = [(-1.0, STOPPED), (0.2, HEALTHY)]
        diagnoses = ((Diagnosed(at, (("mapper",),)), Diagnosed(at + 0.1, ((),))) for at in at_s)
        record.diagnoses = [Diagnosed(-0.1, ((),)), *(each for both in diagnoses for each in both)]
        return score(record, SMALL).alarms

    assert alarms(0.1) == 0  # every process was stopped then
    assert alarms(0.4) == 0  # the observers' delay is 2.5 s
    assert alarms(0.4, 5.0) == 1


def test_the_repair_utility_is_that_of_the_competition() -> None:
    assert repair_utility({"a"}, {"a"}, 10) == 1.0
    assert repair_utility(set(), {"a"}, 10) == pytest.approx(1 - 11 / 20)
    assert repair_utility({"b"}, {"a"}, 10) == pytest.approx(1 - 10 / 20 - 2 / 20)


def drawn(count: int) -> list[Trial]:
    """Return trials, each class in turn."""
    chance = random.Random("drawn")
    found = []
    for number in range(count):
        described = CLASSES[number % len(CLASSES)]
        able = [name for name in robot_names() if described.faults(find_robot(name).anatomy)]
        found.append(Trial(chance.choice(able), described.name, 1, number))
    return found


def played(standin: str, trials: Sequence[Trial]) -> list[Score]:
    terms = Terms("fast")
    return [score(play_with(standin, trial, terms), find_robot(trial.robot)) for trial in trials]


def test_the_perfect_stand_in_is_perfect(long: bool) -> None:
    for found in played("perfect", [t for t in drawn(200 if long else 20) if not BY_NAME[t.cls].apart]):
        assert found.right, found
        assert (found.wrong, found.extra, found.false_repaired, found.alarms) == ([], 0, [], 0), found
        assert found.cause_first or not found.told_apart, found


def test_idling_does_not_win() -> None:
    faults = played("idle", [trial for trial in drawn(20) if not BY_NAME[trial.cls].apart])
    assert not any(found.right for found in faults)
    assert sum(found.points for found in faults) <= 0
    [stretch] = played("idle", [Trial("base", STRETCHES[1].name, 1, 1)])
    assert stretch.points == 1.0


@pytest.mark.parametrize("trial", ["base/hung-node", "underwater/feed", "loops/loop"])
def test_the_parts_of_the_time_to_repaired_add_up(trial: str) -> None:
    robot, cls = trial.split("/")
    [found] = played("perfect", [Trial(robot, cls, 1, 1)])
    assert found.repaired_s is not None
    assert sum(found.parts.values()) == pytest.approx(found.repaired_s)
    assert found.parts["acts"] > 0.1
    assert found.parts["missing effect"] == 0  # it knows what helps
