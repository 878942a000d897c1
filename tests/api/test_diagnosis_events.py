"""The text of a diagnosis event is put together from parts that were made before: it must be what it says."""

from __future__ import annotations

import json

from tests.api.conftest import Service, bad_sets

from robomend.errors import ContradictoryModel
from robomend.robots.current import Current


def test_text_and_object_of_a_diagnosis_agree(service: Service) -> None:
    service.with_robot("told")
    service.observe("not running(rviz)", robot="told")
    found = service.diagnosis("told", after=0, wait_s=60)
    assert bad_sets(found) == [{"rviz"}]
    current = service.runtime.robots.memory.states["told"].current  # what the event was made from
    assert current is not None
    assert current.answer is not None
    data = current.event_data()
    assert json.loads(data.text) == dict(data)


def test_a_fault_instead_of_a_diagnosis_has_its_text_too() -> None:
    from robomend.robots.diagnoser import Diagnosed

    fault = ContradictoryModel((), ())
    answer = Diagnosed.failed(fault)
    data = Current(3, "v", 1, None, {"code": fault.code, "detail": str(fault)}, answer).event_data()
    assert json.loads(data.text) == dict(data)
