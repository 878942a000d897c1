"""From a diagnosis result to a choice: what is planned for, and probes as choosing sees them."""

from __future__ import annotations

from dataclasses import replace

from tests.planning.robots import TEDUSAR

from robomend.diagnosis.probes import Probe, ProbeResult
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.planning.advice import Situation, looks
from robomend.planning.choice import Attempt, Candidate
from robomend.planning.domain.loading import shipped
from robomend.planning.planning import PlanOptions, plan_for, plans_for
from robomend_client.literals import Atom, Literal, fails, holds

MUTE: tuple[Literal, ...] = (holds("on", "jaguar"), holds("running", "jaguar_node"), fails("ok", "odom"))
TIED = (Diagnosis(("jaguar",)), Diagnosis(("jaguar_node",)))


def result(*diagnoses: Diagnosis) -> DiagnosisResult:
    return DiagnosisResult(TEDUSAR.components, diagnoses, True, None, (), 0.0)


def decided(situation: Situation, options: PlanOptions = PlanOptions()) -> tuple[str, ...]:  # noqa: B008  # frozen
    wanted = [diagnosis.bad for diagnosis in situation.wanted]
    choice = situation.decide(plans_for(situation.model, situation.observed, wanted, options))
    return choice.diagnosis.bad if choice.diagnosis else ()


def test_the_tie_is_broken_by_cost_and_by_what_was_tried() -> None:
    situation = Situation(TEDUSAR, MUTE, result(*TIED))
    assert decided(situation) == ("jaguar_node",)
    power = Attempt(frozenset({"jaguar"}), frozenset({"jaguar"}), 0, effect_seen=True, helped=False)
    assert decided(replace(situation, tried=(power,))) == ("jaguar_node",)


def test_with_the_papers_actions_too_the_driver_is_restarted_after_the_power_came_back() -> None:
    """Two rounds: power_up(jaguar), then stop and start of the driver."""
    options = PlanOptions(domain=shipped("paper-repair.pddl"))
    power = Attempt(frozenset({"jaguar"}), frozenset({"jaguar"}), 0, effect_seen=True, helped=False)
    assert decided(Situation(TEDUSAR, MUTE, result(*TIED), (power,)), options) == ("jaguar_node",)


def test_when_the_driver_was_restarted_in_vain_the_device_is_next() -> None:
    driver = Attempt(
        frozenset({"jaguar_node"}), frozenset({"jaguar_node"}), 0, effect_seen=True, helped=False
    )
    situation = Situation(TEDUSAR, MUTE, result(*TIED), (driver, driver))
    assert decided(situation) == ("jaguar",)


def test_the_shared_part_is_planned_for_as_well() -> None:
    found = (Diagnosis(("jaguar", "rviz")), Diagnosis(("jaguar", "imu_node")))
    assert Situation(TEDUSAR, (), result(*found)).wanted == (*found, Diagnosis(("jaguar",)))
    assert Situation(TEDUSAR, (), result(Diagnosis(()))).wanted == ()


def test_probes_become_looks_in_the_order_of_the_candidates() -> None:
    plan = plan_for(TEDUSAR, MUTE, ["jaguar"])
    candidates = [Candidate(Diagnosis((name,)), plan) for name in ("jaguar_node", "jaguar", "rviz")]
    probe = Probe(Atom("ok", ("current(jaguar)",)), 1.0, 2.0, if_true=(1,), if_false=(0,))
    found = ProbeResult((("jaguar",), ("jaguar_node",)), (probe,), (), 0.0, 1.0, True)
    (look,) = looks(found, candidates)
    assert look.predicted == (True, False, None)
    assert look.cost == 2.0
