"""A robot for tools that read SOVD; our own reader of ros2_medkit is one of them."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from tests.api.conftest import Service
from tests.api.repairs_double import REPAIR
from tests.clients.bridges.hearing import hearing

from robomend.api.routers.sovd import STATUS, execution
from robomend.repairs.states import RepairState

SILENT = ["not ok(scan)", "running(hokuyo_node)", "on(hokuyo)", "on(jaguar)"]


def blamed(service: Service, robot: str, *observations: str) -> list[str]:
    """Observe, and return the codes of the faults."""
    service.observe(*observations, robot=robot)
    items = service.api("GET", f"/robots/{robot}/sovd/faults").json()["items"]
    return [fault["fault_code"] for fault in items]


def test_without_a_diagnosis_nobody_says_that_all_is_well(service: Service) -> None:
    source = "robomend: 1\nname: c\nhardware:\n  a: {channel: 1}\nnodes: {}\nrules: ['on(a)']\n"
    assert service.api("PUT", "/models/contradicted", json={"source": source}).status_code == 201
    service.api("PUT", "/robots/odd", json={"model": "contradicted"})
    service.observe("not on(a)", robot="odd")
    for path in ("faults", "components", "components/hokuyo/faults"):
        answer = service.http.get(f"/api/v1/robots/odd/sovd/{path}")
        assert (answer.status_code, answer.json().get("code")) == (409, "conflict"), answer.text
    assert service.http.get("/api/v1/robots/nobody/sovd/faults").status_code == 404


def test_blamed_components_are_faults_of_known_components(service: Service) -> None:
    service.with_robot("blamed")
    codes = blamed(service, "blamed", *SILENT)
    assert "BAD:hokuyo" in codes
    entities = {item["id"] for item in service.api("GET", "/robots/blamed/sovd/components").json()["items"]}
    assert {"hokuyo", "hokuyo_node", "jaguar"} <= entities
    (fault,) = service.api("GET", "/robots/blamed/sovd/components/hokuyo/faults").json()["items"]
    assert fault["reporting_sources"] == ["hokuyo"]
    assert (fault["severity"], fault["status"]) == (1, "PREFAILED")  # the node is as likely
    assert "not ok(scan)" in fault["description"]
    assert service.http.get("/api/v1/robots/blamed/sovd/components/nobody/faults").status_code == 404
    assert service.api("GET", "/robots/blamed/sovd/apps").json()["items"] == []


def test_a_component_that_is_bad_in_every_diagnosis_is_a_confirmed_error(service: Service) -> None:
    service.with_robot("broken")
    assert blamed(service, "broken", "not running(hokuyo_node)") == ["BAD:hokuyo_node"]
    (fault,) = service.api("GET", "/robots/broken/sovd/faults").json()["items"]
    assert (fault["severity"], fault["severity_label"], fault["status"]) == (2, "ERROR", "CONFIRMED")


def test_our_own_reader_of_ros2_medkit_reads_it(service: Service, tmp_path: Path) -> None:
    service.with_robot("read")
    blamed(service, "read", "not running(hokuyo_node)")

    async def test() -> None:
        keys = f"url: {service.url}/api/v1/robots/read/sovd\npoll_s: 0.2"
        async with hearing(tmp_path, "medkit", keys, "diagnostics") as heard:

            def level(name: str) -> int | None:
                levels = {status["name"]: status["level"] for status in heard.last("diagnostics") or ()}
                return levels.get(name)

            await heard.until(lambda: level("hokuyo_node") == 2, "the fault")
            assert level("jaguar") == 0
            await asyncio.to_thread(service.observe, "running(hokuyo_node)", robot="read")
            await heard.until(lambda: level("hokuyo_node") == 0, "all well")
            await heard.told("the stream: /faults/stream is answered with 404")
            assert len(heard.log) == 1

    asyncio.run(test())


def test_a_repair_is_asked_for_and_is_an_execution(service: Service) -> None:
    service.with_robot("r1")
    path = "/api/v1/robots/r1/sovd/operations/repair/executions"
    asked = service.http.post(path, json={"parameters": {"bad": ["hokuyo"], "reason": "dirty"}})
    assert asked.status_code == 202
    assert asked.headers["Location"] == f"{path}/{asked.json()['id']}"
    made = service.api("POST", "/robots/r1/repairs", json={"reason": "it limps"})
    assert (made.status_code, made.headers["location"]) == (202, "/api/v1/repairs/r-1")
    found = service.http.get(path)
    assert found.status_code == 200
    assert service.http.post(path, json={"parameters": {"bat": []}}).status_code == 422


@pytest.mark.parametrize("state", RepairState)
def test_every_state_of_a_repair_has_a_status(state: RepairState) -> None:
    told = execution({**REPAIR, "state": str(state)}).model_dump(mode="json", by_alias=True)
    assert (told["status"], told["x-robomend-state"]) == (STATUS[state], state.value)
