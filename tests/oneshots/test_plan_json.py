"""Choices and plans as JSON."""

from __future__ import annotations

import json

from tests.planning.robots import ALL_OFF, POWER_UP, TEDUSAR

from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.oneshots.plan_json import choice_json, layers
from robomend.planning.advice import Situation
from robomend.planning.planning import plan_for, plans_for
from robomend_client.literals import fails, holds

MUTE = (holds("on", "jaguar"), holds("running", "jaguar_node"), fails("ok", "odom"))
TIED = (Diagnosis(("jaguar",)), Diagnosis(("jaguar_node",)))


def test_layers_are_what_can_start_together() -> None:
    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP)
    names = [{str(plan.steps[index]) for index in layer} for layer in layers(plan)]
    assert {"power_up(jaguar)", "start_node(joy_node)"} <= names[0]
    assert {"start_node(jaguar_node)", "start_node(jaguar_teleop_node)"} <= names[1]
    assert names[2] == {"start_node(hector_mapping)"}


def test_the_answer_is_json_and_says_what_else_could_be_done() -> None:
    situation = Situation(TEDUSAR, MUTE, DiagnosisResult(TEDUSAR.components, TIED, True, None, (), 0.0))
    plans = plans_for(TEDUSAR, MUTE, [one.bad for one in situation.wanted])
    answer = json.loads(json.dumps(choice_json(situation.decide(plans), TEDUSAR.components)))
    assert [one["bad"] for one in answer["alternatives"]] == [["jaguar_node"], ["jaguar"]]
    assert answer["alternatives"][1]["helps"] == 0.75  # the driver's half, and half of the device's
    assert answer["plan"]["outcome"] == "solved"
