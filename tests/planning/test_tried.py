"""What was tried, and how probable each diagnosis is after it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from tests.planning.candidates import SECOND, candidate, plan, tried
from tests.planning.robots import TEDUSAR

from robomend.diagnosis.result import Diagnosis
from robomend.planning.choice import Candidate, choose
from robomend.planning.cures import CURES, Cure
from robomend.planning.planning import plan_for
from robomend.planning.quarantine import BACKOFF_S, DEFAULT_PATIENCE, FAILURES, MAX_BACKOFF_S
from robomend.planning.tried import (
    AGAIN_FACTOR,
    COMPONENT_ODDS,
    LEADING,
    MEMORY_S,
    SEEN_FACTOR,
    UNSEEN_FACTOR,
    Attempt,
    attempt,
    leading,
    repaired_by,
    unbroken_fits,
    weights,
)
from robomend_client.literals import fails


def test_the_page_names_the_numbers() -> None:
    page = " ".join((Path(__file__).parents[2] / "docs" / "planning.md").read_text().split())
    numbers = {1: "One", 2: "Two", 3: "Three", 6: "six"}
    assert f"For up to {numbers[LEADING]} leading diagnoses" in page
    assert f"{numbers[FAILURES]} failures in a row put a component in quarantine" in page
    assert f"for {BACKOFF_S / 60:g} minutes, doubled by each further failure, up to a day" in page
    assert MAX_BACKOFF_S == 24 * 3600
    assert f"allows actions ({DEFAULT_PATIENCE.relapses})" in page
    assert (DEFAULT_PATIENCE.relapse_s, MEMORY_S) == (30, 3600)  # "within half a minute", "for an hour"
    assert (SEEN_FACTOR, UNSEEN_FACTOR) == (1 / 10, 1 / 2)  # "to a tenth", "to a half"
    assert AGAIN_FACTOR == 1 / 2  # "each further time to a half"


def test_a_restart_that_came_with_the_power_cycle_counts_against_the_driver_too() -> None:
    found = weights(
        [Diagnosis(("jaguar",)), Diagnosis(("jaguar_node",)), Diagnosis(("imu_node",))],
        [tried("jaguar", repaired="jaguar jaguar_node")],
    )
    assert found[0] == found[1] < found[2]


def test_a_power_cycle_in_vain_says_half_as_much_against_a_device_as_it_would_cure_it() -> None:
    """One that is broken is not cured by it; that its driver was restarted with it says as much as ever."""
    diagnoses = [Diagnosis(("lidar",)), Diagnosis(("driver",)), Diagnosis(("other",))]
    cycle = replace(tried("lidar", repaired="lidar driver"), cycled=frozenset({"lidar"}))
    lidar, driver, other = weights(diagnoses, [cycle])
    assert lidar / other == pytest.approx(1 - CURES[Cure.POWER_CYCLE] * (1 - SEEN_FACTOR))
    assert driver / other == pytest.approx(SEEN_FACTOR)


def test_the_memory_of_a_power_cycle_names_what_it_was_to_cure_as_far_as_it_was_done() -> None:
    plan = plan_for(TEDUSAR, [], ["hokuyo"])

    def memory(done: list[int] | None) -> Attempt:
        return attempt(Diagnosis(("hokuyo",)), plan, done=done, time_ns=1, effect_seen=True, helped=False)

    assert memory(None).cycled == {"hokuyo"}
    assert memory([0]).cycled == frozenset()  # it was cut, and did not come back
    off = plan_for(TEDUSAR, [fails("on", "hokuyo")], ["hokuyo"])
    switched_on = attempt(Diagnosis(("hokuyo",)), off, done=None, time_ns=1, effect_seen=True, helped=False)
    assert switched_on.cycled == frozenset()


def test_an_attempt_counts_against_each_component_that_it_repaired_and_only_if_it_did_not_help() -> None:
    """A repair of a that restarted b made both good: what blames both now takes two restarts in vain."""
    diagnoses = [Diagnosis(("a", "b")), Diagnosis(("a", "c")), Diagnosis(("c", "d"))]
    for seen, factor in ((True, SEEN_FACTOR), (False, UNSEEN_FACTOR)):
        both, one, none = weights(diagnoses, [tried("a", repaired="a b", seen=seen)])
        assert (both / none, one / none) == pytest.approx((factor**2, factor))
    assert weights(diagnoses, [tried("a", repaired="a b", helped=True)]) == [1 / 3, 1 / 3, 1 / 3]


def test_what_could_not_be_carried_out_counts_against_its_own_diagnosis_alone() -> None:
    diagnoses = [Diagnosis(("a", "b")), Diagnosis(("a", "c"))]
    own, other = weights(diagnoses, [replace(tried("a b", seen=False), repaired=frozenset())])
    assert own / other == pytest.approx(UNSEEN_FACTOR)


def test_a_driver_that_was_restarted_in_vain_beside_another_is_not_restarted_with_the_others_device() -> None:
    """Two devices hang. To cycle one, and to restart the driver of the other once more, would mend one."""
    drivers, devices = ("hokuyo_node", "jaguar_node"), ("hokuyo", "jaguar")
    mixed = [("hokuyo_node", "jaguar"), ("hokuyo", "jaguar_node")]
    candidates = [Candidate(Diagnosis(bad), plan_for(TEDUSAR, [], bad)) for bad in (devices, *mixed, drivers)]
    assert choose(candidates).diagnosis == Diagnosis(drivers)
    assert choose(candidates, [tried(" ".join(drivers))]).diagnosis == Diagnosis(devices)


def test_an_attempt_counts_as_long_as_it_is_remembered() -> None:
    diagnoses = [Diagnosis(("a",)), Diagnosis(("b",))]
    until_ns = int(MEMORY_S) * SECOND
    assert weights(diagnoses, [tried("a")], now_ns=until_ns)[0] < 0.5
    assert weights(diagnoses, [tried("a")], now_ns=until_ns + 1) == [0.5, 0.5]
    for now_ns, failures in ((until_ns, 1), (until_ns + 1, 0)):
        choice = choose([candidate("a", 4)], [tried("a")], now_ns=now_ns)
        assert choice.alternatives[0].failures == failures


def test_small_diagnoses_lead_and_the_healthy_one_is_none() -> None:
    diagnoses = [Diagnosis(("a", "b")), Diagnosis(("c",)), Diagnosis(())]
    assert [one.bad for one in leading(diagnoses)] == [("c",), ("a", "b")]


def test_an_attempt_remembers_only_what_was_carried_out() -> None:
    made = plan(10, "a", "b")
    memory = attempt(Diagnosis(("a", "b")), made, done=[0], time_ns=5, effect_seen=True, helped=False)
    assert memory.repaired == {"a"}
    assert memory.actions == ("mend(a)",)
    assert repaired_by(made) == {"a", "b"}


def test_what_was_surely_broken_and_is_not_blamed_is_one_fault_more_at_its_odds() -> None:
    odds = COMPONENT_ODDS
    diagnoses = [("driver", "task"), ("camera", "driver"), ("camera",)]
    assert unbroken_fits(diagnoses, {"driver", "task"}, {}) == pytest.approx([1.0, odds, odds**2])
    assert unbroken_fits(diagnoses, {"driver"}, {"driver": 0.2}) == pytest.approx([1.0, 1.0, 0.25])
    assert unbroken_fits([], {"driver"}, {}) == []


def test_what_many_were_known_to_be_does_not_drown_what_diagnoses_differ_in() -> None:
    """A robot of 400 nodes had lost its power, and all but two of them are back."""
    known = {f"n{index}" for index in range(400)}
    assert unbroken_fits([("n0",), ("device",)], known, {}) == pytest.approx([1.0, 0.01])
