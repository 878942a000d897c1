"""Choosing what to repair: probability over cost, memory of what was tried, probes, quarantine."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.planning.robots import TEDUSAR

from robomend.diagnosis.result import Diagnosis
from robomend.planning.choice import ASK_COST, PERSON_COST, SURE, Candidate, Look, choose, common_part
from robomend.planning.cures import CURES, Cure
from robomend.planning.plan import Outcome, Plan, Step
from robomend.planning.planning import plan_for
from robomend.planning.quarantine import (
    BACKOFF_S,
    DEFAULT_PATIENCE,
    FAILURES,
    MAX_BACKOFF_S,
    Patience,
    Quarantined,
    came_back,
    quarantined,
    relapses,
    unlasting,
)
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
from robomend_client.literals import Atom, fails, holds

SECOND = 1_000_000_000


def plan(cost: float, *repairs: str, unreachable: tuple[str, ...] = ()) -> Plan:
    steps = tuple(
        Step(i, "mend", (name,), cost / len(repairs), (), (), (holds("good", name), fails("bad", name)))
        for i, name in enumerate(repairs)
    )
    outcome = Outcome.UNSOLVABLE if unreachable else Outcome.SOLVED
    return Plan(outcome, steps, cost if steps else 0.0, "test", frozenset(), (), unreachable, (), 0.0)


def candidate(
    bad: str, cost: float, probability: float | None = None, repairs: str | None = None
) -> Candidate:
    names = tuple(bad.split())
    made = plan(cost, *(repairs.split() if repairs is not None else names))
    return Candidate(Diagnosis(names, probability), made)


def tried(bad: str, *, seen: bool = True, helped: bool = False, at_s: int = 0, repaired: str = "") -> Attempt:
    return Attempt(frozenset(bad.split()), frozenset((repaired or bad).split()), at_s * SECOND, seen, helped)


def test_another_way_comes_before_the_same_that_did_not_help() -> None:
    """A restart for 4 was done in vain; the spare for 44 is next, not the restart once more."""
    spare = candidate("gps", 44, repairs="gps driver")
    restart = candidate("driver", 4)
    history = [
        replace(tried("driver"), actions=("mend(driver)",)),
        replace(
            tried("gps", repaired="gps driver", at_s=1),
            actions=("cycle(gps)", "mend(driver)"),
            cycled=frozenset({"gps"}),
        ),
    ]
    assert choose([restart, spare]).plan is restart.plan
    assert choose([restart, spare], history).plan is spare.plan
    assert choose([restart], history).plan is restart.plan  # where nothing else is left, once more


def test_what_was_done_in_vain_is_not_repeated_where_that_costs_more_than_it_saves() -> None:
    """The device is in quarantine; the driver was restarted, each time with its effect seen."""
    device = Candidate(Diagnosis(("imu",)), replace(plan(0), excluded=("imu",)))
    driver = candidate("driver", 4)
    vain = [replace(tried("driver", at_s=at), actions=("mend(driver)",)) for at in range(3)]
    assert choose([device, driver], vain[:1]).plan is driver.plan
    assert choose([driver], vain[:2]).plan is driver.plan
    nothing = choose([device, driver], vain[:2])
    helps = next(one.helps for one in nothing.alternatives if one.diagnosis.bad == ("driver",))
    assert helps < driver.plan.cost / PERSON_COST
    assert nothing.plan is None
    assert nothing.reason == (
        "probably imu itself: a person is needed; "
        "no known repair: driver was repaired before, and it did not help; "
        "imu left alone for a while, as its repairs keep failing or do not last; "
        "suspected most: imu (95% likely), driver (5% likely)"
    )


def test_what_every_diagnosis_blames_is_repaired_first_when_that_pays() -> None:
    candidates = [candidate("psu a", 40, 0.5), candidate("psu b", 40, 0.5)]
    shared = common_part([one.diagnosis for one in candidates])
    assert shared == ("psu",)
    common = candidate("psu", 10)
    choice = choose(candidates, common=common)
    assert choice.plan is common.plan
    assert "psu" in choice.reason


def test_a_cheap_look_that_tells_diagnoses_apart_comes_before_a_dear_repair() -> None:
    candidates = [candidate("a", 30, 0.5), candidate("b", 30, 0.5)]
    look = Look(Atom("ok", ("t",)), 1.0, (True, False))
    choice = choose(candidates, looks=[look])
    assert choice.probe == look
    assert choice.expected_cost == 31


def test_a_repair_that_covers_two_diagnoses_leaves_neither_to_pay_for() -> None:
    both = candidate("a", 6, 0.5, repairs="a b")
    assert choose([both, candidate("b", 5, 0.5)]).expected_cost == 6


def test_expected_cost_of_a_look_is_its_own_and_that_of_what_follows_each_answer() -> None:
    """Yes: it is a, or c by half; no: b, or c by half. c is repaired last, for 8, where it is left."""
    candidates = [candidate("a", 20, 0.5), candidate("b", 40, 0.3), candidate("c", 8, 0.2)]
    look = Look(Atom("ok", ("t",)), 1.0, (True, False, None))
    # After yes (0.6): c for 8 first (0.1 / 8 < 0.5 / 20, so a first): 20 * 0.6 + 8 * 0.1.
    # After no (0.4): c (0.1 / 8) before b (0.3 / 40): 8 * 0.4 + 40 * 0.3.
    choice = choose(candidates, looks=[look])
    assert choice.probe == look
    assert abs(choice.expected_cost - (1 + 20 * 0.6 + 8 * 0.1 + 8 * 0.4 + 40 * 0.3)) < 1e-9
    assert choose(candidates, looks=[replace(look, cost=2.0), look, replace(look, cost=3.0)]).probe == look


def test_what_has_no_plan_because_it_is_left_alone_is_told_as_that_and_anything_else_as_it_is() -> None:
    left_alone = replace(plan(0), excluded=("a",))
    aside, other = (Candidate(Diagnosis((name,)), left_alone) for name in ("a", "b"))
    assert choose([aside, other]).reason == (
        "no known repair: nothing to do about b; "
        "a left alone for a while, as its repairs keep failing or do not last"
    )
    late = Candidate(Diagnosis(("c",)), replace(plan(0), outcome=Outcome.GAVE_UP))
    assert choose([late]).reason == "no repair was found in time: no plan for c was found in time"


def test_part_of_a_diagnosis_is_repaired_when_the_rest_cannot_be() -> None:
    half = Candidate(Diagnosis(("imu", "node")), plan(4, "node", unreachable=("imu: no known action …",)))
    choice = choose([half])
    assert choice.plan is half.plan
    assert "not all of it" in choice.reason


def test_what_soon_breaks_again_however_often_it_is_mended_is_quarantined() -> None:
    patience = Patience(relapses=3, relapse_s=60)

    def aside(*mended_at_s: int, now_s: int, suspected: str = "a") -> dict[str, Quarantined]:
        names, now_ns = suspected.split(), now_s * SECOND
        mended = [tried("a", helped=True, at_s=at) for at in mended_at_s]
        row = relapses(mended, names, now_ns=now_ns, patience=patience)
        return came_back(row, names, now_ns=now_ns, patience=patience)

    assert aside(0, 30, now_s=61) == {}
    third = aside(0, 30, 60, now_s=61)["a"]
    assert (third.failures, third.until_ns) == (3, 360 * SECOND)
    assert third.reason == "a: 3 repairs in a row helped, and soon it came back"
    assert aside(0, 30, 60, now_s=61, suspected="b") == {}
    assert aside(0, 30, 60, now_s=121) == {}  # the third has lasted
    assert aside(0, 30, 91, now_s=92) == {}  # as the second had
    # One more when the back-off is over: it does not last either, so that the time doubles.
    assert aside(0, 30, 60, 365, now_s=366)["a"].until_ns == 965 * SECOND
    assert aside(0, 30, 60, 500, now_s=501) == {}


def test_half_a_minute_is_half_a_minute_after_a_quarantine_too() -> None:
    def row(last_s: int) -> list[int]:
        times = (41, 52, 63, last_s)
        mended = [replace(tried("a", helped=True, at_s=at), began_ns=(at - 1) * SECOND) for at in times]
        found = relapses(mended, {"a"}, now_ns=(last_s + 8) * SECOND)
        return [one.time_ns // SECOND for one in found]

    assert row(92) == [41, 52, 63, 92]
    assert row(200) == [200]  # it had lasted for two minutes, whatever would have been left alone
    assert row(362) == [362]
    assert row(366) == [41, 52, 63, 366]  # it has waited for the end of its quarantine, 300 s later
    assert row(400) == [400]


def test_what_helped_and_did_not_last_is_no_cure() -> None:
    short, other = tried("a", helped=True), tried("b", helped=True, at_s=1)
    memory = unlasting([short, other], [short])
    assert [one.helped for one in memory] == [False, True]
    choice = choose([candidate("a", 4), candidate("b", 4)], memory)
    assert choice.diagnosis == Diagnosis(("b",))
    (again,) = (one for one in choice.alternatives if one.diagnosis.bad == ("a",))
    assert again.reason.endswith("; repaired once before, and soon it was broken again")


def test_power_is_not_cut_a_third_time_for_what_soon_comes_back() -> None:
    device = cutting("device", 29, 1.0)
    assert choose([device], relapses=DEFAULT_PATIENCE.relapses - 2).plan is not None
    nothing = choose([device], relapses=DEFAULT_PATIENCE.relapses - 1)
    assert nothing.plan is None
    assert nothing.reason.endswith("; power is not cut again for what soon comes back")
    assert choose([device, candidate("driver", 4, 0.1)], relapses=9).diagnosis == Diagnosis(("driver",), 0.1)


def test_three_failures_in_a_row_are_quarantined_with_doubling_back_off() -> None:
    failures = [tried("a", at_s=t) for t in (0, 10, 20)]
    assert quarantined(failures[:2], now_ns=11 * SECOND) == {}
    assert quarantined(failures, now_ns=21 * SECOND)["a"].until_ns == 320 * SECOND
    assert quarantined(failures, now_ns=321 * SECOND) == {}
    fourth = [*failures, tried("a", at_s=330)]
    assert quarantined(fourth, now_ns=331 * SECOND)["a"].until_ns == 930 * SECOND


def test_success_ends_a_series_of_failures() -> None:
    failures = [tried("a", at_s=t) for t in (0, 10, 20)]
    assert quarantined([*failures, tried("a", helped=True, at_s=30)], now_ns=31 * SECOND) == {}


def expected_cost(order: tuple[int, ...], chances: list[float], costs: list[float]) -> float:
    total, left = 0.0, 1.0
    for index in order:
        total += costs[index] * left
        left -= chances[index]
    return total


@given(st.lists(st.tuples(st.integers(1, 20), st.integers(1, 40)), min_size=1, max_size=5))
def test_the_order_is_the_one_of_least_expected_cost(cases: list[tuple[int, int]]) -> None:
    """Against every order, for diagnoses that exclude one another."""
    total = sum(chance for chance, _ in cases)
    chances = [chance / total for chance, _ in cases]
    costs = [cost / 10 for _, cost in cases]  # much less than a second, and some seconds
    candidates = [candidate(f"c{i}", costs[i], chances[i]) for i in range(len(cases))]
    choice = choose(candidates)
    least = min(expected_cost(order, chances, costs) for order in permutations(range(len(cases))))
    assert abs(choice.expected_cost - least) < 1e-6
    mine = tuple(int(one.diagnosis.bad[0][1:]) for one in choice.alternatives)
    assert abs(expected_cost(mine, chances, costs) - least) < 1e-6


def test_what_was_done_in_vain_together_with_something_else_is_not_done_again_alone_first() -> None:
    """Two drivers were restarted, of one the topic is back: of the other it is the device now."""
    both = replace(tried("driver other"), actions=("mend(driver)", "mend(other)"))
    choice = choose([candidate("driver", 4), candidate("device", 45)], [both])
    assert choice.diagnosis == Diagnosis(("device",))
    driver = next(one for one in choice.alternatives if one.diagnosis.bad == ("driver",))
    assert driver.failures == 1
    # What it restarted on the way, as it mended something else, may still have come up mute.
    cycle = replace(both, bad=frozenset({"device"}))
    assert choose([candidate("driver", 4), candidate("device", 45)], [cycle]).diagnosis == Diagnosis(
        ("driver",)
    )


def cutting(bad: str, cost: float, probability: float) -> Candidate:
    """Return a diagnosis of a device whose plan cycles its power."""
    cycled = planned_by_cycling(bad, cost)
    return Candidate(Diagnosis((bad,), probability), cycled)


def planned_by_cycling(device: str, cost: float) -> Plan:
    off, on = (holds("off", device), fails("on", device)), (holds("on", device), fails("off", device))
    steps = (
        Step(0, "shutdown", (device,), cost / 2, (), (), off),
        Step(1, "power_up", (device,), cost / 2, (), (), (*on, holds("good", device), fails("bad", device))),
    )
    return replace(plan(cost, device), steps=steps)


def hopeless(bad: str, probability: float) -> Candidate:
    """Return a diagnosis that nothing can be done about any more."""
    return Candidate(Diagnosis((bad,), probability), plan(0, unreachable=(f"{bad}: it was done in vain",)))


def test_what_no_act_mends_is_said_first_and_a_person_is_not_asked_to_repeat_what_hardly_helps() -> None:
    """Device and driver cannot be told apart; to restart the driver was in vain."""
    device, driver = hopeless("imu", 0.5), candidate("driver", 4, 0.5)
    first = choose([device, driver])
    assert (first.plan, first.beyond) == (driver.plan, "")
    vain = [replace(tried("driver"), actions=("mend(driver)",))]
    again = choose([device, driver], vain)
    assert again.plan is driver.plan
    assert again.reason.startswith("probably imu itself: a person is needed; driver: helps with probability")
    asked = choose([device, replace(driver, asks=True)], vain)
    assert asked.plan is None
    assert asked.reason.startswith("probably imu itself: a person is needed; no known repair: ")
    assert choose([device, replace(driver, asks=True)]).plan is driver.plan


@given(st.lists(st.tuples(st.integers(1, 60), st.integers(1, 90), st.booleans()), min_size=1, max_size=4))
def test_something_is_done_just_where_that_costs_less_than_to_ask_a_person_at_once(
    cases: list[tuple[int, int, bool]],
) -> None:
    """Against every order of every choice of the plans; what nothing repairs is the rest."""
    chances = [chance / 240 for chance, _, _ in cases]
    candidates = [
        replace(candidate(f"c{i}", cost, chances[i]), asks=asks) for i, (_, cost, asks) in enumerate(cases)
    ]
    rest = 1 - sum(chances)
    if rest > 0:
        candidates.append(hopeless("rest", rest))
    costs = [cost + ASK_COST * asks for _, cost, asks in cases]
    orders = (order for count in range(1, len(cases) + 1) for order in permutations(range(len(cases)), count))
    least = min(
        expected_cost(order, chances, costs) + PERSON_COST * (1 - sum(chances[i] for i in order))
        for order in orders
    )
    choice = choose(candidates)
    sure = any(one.helps >= SURE for one in choice.alternatives)
    if sure or abs(least - PERSON_COST) > 1e-6:
        assert (choice.plan is not None) is (sure or least < PERSON_COST)


def test_power_is_never_cycled_for_ever() -> None:
    """Whatever is chosen fails: each component is left alone after its attempts, or does not pay any more."""
    candidates = {"jaguar": candidate("jaguar", 29), "jaguar_node": candidate("jaguar_node", 4)}
    memory: list[Attempt] = []
    for turn in range(20):
        aside = quarantined(memory, now_ns=turn * SECOND)
        open_ones = [one for name, one in candidates.items() if name not in aside]
        if not open_ones:
            break
        choice = choose(open_ones, memory, now_ns=turn * SECOND)
        if choice.plan is None:
            break
        assert choice.diagnosis is not None
        memory.append(
            attempt(
                choice.diagnosis,
                choice.plan,
                done=None,
                time_ns=turn * SECOND,
                effect_seen=True,
                helped=False,
            )
        )
    times = Counter(name for one in memory for name in one.bad)
    assert times == {"jaguar": 2, "jaguar_node": 3}  # a third time for 29 hardly helps


# --- what was tried, and how probable each diagnosis is after it


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
