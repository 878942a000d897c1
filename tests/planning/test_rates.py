"""How probably acts cure: given in the model, learned from outcomes, and what they make of the choice."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.planning.robots import texts

from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.errors import ModelError
from robomend.model.components import ComponentModel
from robomend.model.loading import load_text
from robomend.planning.advice import Situation
from robomend.planning.cures import PRIOR_WEIGHT, ActOutcome, SuccessRate, cured, curing, rates
from robomend.planning.plan import Plan
from robomend.planning.planning import PlanOptions, plans_at_once, plans_for

CAMERA = """\
robomend: 1
hardware: {lidar: {channel: 1, helps: {power_cycle: 0.8}}}
nodes:
  camera:
    publishes: {image: []}
    modes: {soft: ["not ok(image)"], hard: ["not ok(image)", "not ok(log)"]}
    helps: {restart: {soft: 0.9, hard: 0.05}, redeploy: {soft: 0.9, hard: 0.95}}
  lidar_node: {drives: [lidar], publishes: {scan: []}}
remedies:
  redeploy: {mends: camera, cost: 8}
"""


def model(text: str = CAMERA) -> ComponentModel:
    parts = load_text(text).parts
    assert parts is not None
    return parts


def planned(known: dict[tuple[str, str], SuccessRate], text: str = CAMERA, bad: str = "camera") -> Plan:
    options = PlanOptions(rates=tuple(known.values()))
    at_once = plans_at_once(model(text), (), [[bad]], options)
    (plan,) = plans_for(model(text), (), [[bad]], options)
    assert at_once is not None
    assert texts(at_once[0]) == texts(plan)
    return plan


def test_the_fault_mode_decides_which_act_comes_first() -> None:
    soft, hard = ({"camera": mode} for mode in ("soft", "hard"))
    assert texts(planned(rates(model(), soft, ()))) == ["stop_node(camera)", "start_node(camera)"]
    assert texts(planned(rates(model(), hard, ()))) == ["redeploy(camera)"]
    assert texts(planned({})) == ["stop_node(camera)", "start_node(camera)"]  # the cheapest, as ever


def test_a_mode_that_says_what_another_one_says_is_not_known_nor_learned_of() -> None:
    alike = model(CAMERA.replace(', "not ok(log)"', ""))
    for told in ("soft", "hard"):
        found = rates(alike, {"camera": told}, [ActOutcome("camera", frozenset({"restart"}), False, "soft")])
        restart = found["restart", "camera"]
        assert restart.prior == pytest.approx(0.475)
        assert (restart.helped, restart.of) == (0, 1)


def test_outcomes_change_what_is_given_and_the_order_with_it() -> None:
    text = CAMERA.replace("{soft: 0.9, hard: 0.05}", "0.6").replace("{soft: 0.9, hard: 0.95}", "0.4")
    assert texts(planned(rates(model(text), {}, ()), text)) == ["stop_node(camera)", "start_node(camera)"]
    vain = [ActOutcome("camera", frozenset({"restart"}), False)] * 8
    cure = [ActOutcome("camera", frozenset({"redeploy"}), True)] * 8
    learned = rates(model(text), {}, [*vain, *cure])
    assert str(learned["restart", "camera"]) == "restart of camera 20% (60% given, 0 of 8 helped)"
    assert str(learned["redeploy", "camera"]) == "redeploy of camera 80% (40% given, 8 of 8 helped)"
    assert texts(planned(learned, text)) == ["redeploy(camera)"]


def test_what_came_of_it_in_the_fleet_is_what_one_begins_with() -> None:
    text = CAMERA.replace("{soft: 0.9, hard: 0.05}", "0.6").replace("{soft: 0.9, hard: 0.95}", "0.4")
    elsewhere = [ActOutcome("camera", frozenset({"restart"}), helped < 7, fleet=True) for helped in range(20)]
    own = [ActOutcome("camera", frozenset({"restart"}), helped < 2) for helped in range(3)]
    rate = rates(model(text), {}, [*elsewhere, *own])["restart", "camera"]
    assert str(rate) == "restart of camera 51% (60% given, 7 of 20 helped in the fleet, 2 of 3 helped)"
    assert rate.mean == pytest.approx((4 * (4 * 0.6 + 7) / 24 + 2) / 7)
    vain = [ActOutcome("camera", frozenset({"restart"}), False, fleet=True)] * 8
    assert texts(planned(rates(model(text), {}, vain), text)) == ["redeploy(camera)"]


def test_where_nothing_is_given_a_few_outcomes_or_good_ones_change_nothing() -> None:
    plain = CAMERA.replace(
        "    helps: {restart: {soft: 0.9, hard: 0.05}, redeploy: {soft: 0.9, hard: 0.95}}\n", ""
    )
    good, vain = (ActOutcome("camera", frozenset({"restart"}), helped) for helped in (True, False))
    assert ("restart", "camera") not in rates(model(plain), {}, [good] * 50)
    assert ("restart", "camera") not in rates(model(plain), {}, [vain] * 2)
    found = rates(model(plain), {}, [vain] * 2 + [good] * 2)["restart", "camera"]
    assert (found.given, found.mean) == (False, 0.75)
    assert ("redeploy", "gone") not in rates(
        model(plain), {}, [ActOutcome("gone", frozenset({"x"}), False)] * 9
    )


def test_a_power_cycle_has_a_rate_of_its_own() -> None:
    known = rates(model(), {}, ())
    plan = planned(known, bad="lidar")
    assert curing(plan, ["lidar"])["lidar"][0] == "power_cycle"
    assert cured(plan, ["lidar"]) == 0.5
    assert cured(plan, ["lidar"], known=known) == pytest.approx(0.8)


def test_the_reason_says_why() -> None:
    known = rates(
        model(), {"camera": "hard"}, [ActOutcome("camera", frozenset({"redeploy"}), True, "hard")] * 2
    )
    result = DiagnosisResult(
        model().components, (Diagnosis(("camera",), modes={"camera": "hard"}),), True, None, (), 0.0
    )
    situation = Situation(model(), (), result, rates=known)
    choice = situation.decide([planned(known)])
    assert choice.reason == (
        "camera: helps with probability 0.97 at cost 8; redeploy of camera 97% (95% given, 2 of 2 helped)"
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("restart: {soft: 0.9", "restart: {sift: 0.9", "none of its modes; did you mean `soft`"),
        ("power_cycle: 0.8", "power_cycle: 1", "between 0 and 1"),
        ("power_cycle: 0.8", "power_cycle: often", "between 0 and 1"),
    ],
)
def test_mistakes_are_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load_text(CAMERA.replace(old, new))


@given(st.floats(0.01, 0.99), st.integers(0, 200), st.integers(0, 200))
def test_a_rate_lies_between_what_is_given_and_what_was_seen(prior: float, helped: int, vain: int) -> None:
    mean = SuccessRate("restart", "camera", prior, True, helped, helped + vain).mean
    seen = helped / (helped + vain) if helped + vain else prior
    assert min(prior, seen) - 1e-9 <= mean <= max(prior, seen) + 1e-9
    assert abs(mean - seen) <= PRIOR_WEIGHT / (PRIOR_WEIGHT + helped + vain) + 1e-9
