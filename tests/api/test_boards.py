"""A robot's board: its channels in OBS, switched over HTTP, and never against a protection."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from tests.api.conftest import Service, StartService
from tests.api.test_moments import moment
from tests.robomend_board.processes import running as board_running
from tests.waiting import until

from robomend.store import global_stop


@pytest.fixture
def board() -> Iterator[int]:
    """The port of an emulated board, whose channels 2 and 7 are on at power-up."""
    with board_running("--on", "2,7") as process:
        yield process.port


def seen(service: Service, *wanted: str) -> None:
    """Wait until the board has these literals in OBS."""

    def held() -> set[str]:
        found = service.api("GET", "/robots/r1/observations").json()["observations"]
        return {one["literal"] for one in found if one["source"] == "board"}

    until(lambda: held() >= set(wanted), f"{wanted} is in OBS")


def test_channels_are_observed_switched_and_protected(start: StartService, board: int) -> None:
    service = start()
    service.with_robot(board={"host": "127.0.0.1", "port": board, "rate_hz": 20, "protected": [2, 7]})
    seen(service, "on(jaguar)", "not on(hokuyo)")
    shown = service.api("GET", "/robots/r1/board").json()
    assert shown["state"] == "connected"
    assert shown["channels"][7]["component"] == "jaguar"
    assert shown["channels"][7]["protected"]

    assert service.api("PUT", "/robots/r1/board/channels/3", json={"on": True}).status_code == 204
    seen(service, "on(hokuyo)")
    refused = service.api("PUT", "/robots/r1/board/channels/7", json={"on": False})
    assert (refused.status_code, refused.json()["code"]) == (403, "refused")
    assert service.api("PUT", "/robots/r1/board/channels/99", json={"on": True}).status_code == 404
    noted = service.api("GET", "/audit", params={"robot": "r1"}).json()["items"]
    assert "channel.on" in {entry["action"] for entry in noted}
    assert 'robomend_board_link{robot="r1",state="connected"} 1.0' in service.http.get("/metrics").text


def test_a_moment_has_the_board_as_it_was_when_it_came(start: StartService, board: int) -> None:
    service = start()
    service.with_robot(board={"host": "127.0.0.1", "port": board, "rate_hz": 20, "protected": []})
    seen(service, "on(jaguar)", "not on(hokuyo)")
    one = service.api("POST", "/robots/r1/moments", json=moment(complete=False)).json()["id"]
    assert service.api("PUT", "/robots/r1/board/channels/3", json={"on": True}).status_code == 204
    seen(service, "on(hokuyo)")
    assert service.api("POST", "/robots/r1/moments", json=moment()).json()["id"] == one
    found = service.api("GET", f"/moments/{one}").json()
    assert found["complete"]
    assert [(each["component"], each["on"]) for each in found["board"] if each["component"] == "hokuyo"] == [
        ("hokuyo", False)
    ]
    assert "Power board" in service.http.get(f"/ui/moments/{one}").text


def test_a_board_that_is_gone_is_unknown_and_does_not_stop_the_service(
    start: StartService, board: int
) -> None:
    service = start()
    service.with_robot(board={"host": "127.0.0.1", "port": board, "rate_hz": 20})
    seen(service, "on(jaguar)")
    away = {"host": "127.0.0.1", "port": 1}
    body = {"model": "tedusar", "board": away}
    assert service.api("PUT", "/robots/r1", json=body, headers={"If-Match": "*"}).status_code == 200
    answer = service.api("PUT", "/robots/r1/board/channels/3", json={"on": True})
    assert (answer.status_code, answer.json()["code"]) == (503, "board-unreachable")
    checks: dict[str, Any] = {}

    def told() -> bool:
        checks.update(service.http.get("/readyz").json()["checks"])  # of the boards, if there is time
        return "boards" in checks

    until(told, "boards are told")
    assert checks["boards"]["ok"] is False
    until(
        lambda: not service.api("GET", "/robots/r1/observations").json()["observations"],
        "a board that is gone says no more what is on",
    )
    assert service.http.get("/readyz").status_code == 200


FED = """
robomend: 1
name: fed
protected_channels: [0]
hardware:
  rail: {channel: 7}
  hub: {fed_by: [rail]}
  camera: {channel: 3, fed_by: [hub]}
  lamp: {channel: 4, fed_by: [hub]}
nodes:
  lamp_d: {drives: [lamp], publishes: {lux: []}}
"""


def switch_off(service: Service, channel: int) -> tuple[int, str]:
    """Ask for a channel to be switched off; return the status and what is said."""
    answer = service.api("PUT", f"/robots/r1/board/channels/{channel}", json={"on": False})
    return answer.status_code, "" if answer.status_code == 204 else answer.json()["detail"]


def test_a_person_does_not_switch_off_what_the_robot_protects_nor_what_feeds_it(
    start: StartService, board: int
) -> None:
    service = start()
    service.api("PUT", "/models/fed", json={"source": FED})
    at = {"host": "127.0.0.1", "port": board, "rate_hz": 20, "protected": []}
    config = {"model": "fed", "protected": ["camera"], "board": at}
    assert service.api("PUT", "/robots/r1", json=config).status_code == 201
    seen(service, "on(rail)")
    assert switch_off(service, 3) == (403, "channel 3 is protected: camera is protected")
    assert switch_off(service, 7) == (403, "channel 7 is protected: camera, which it feeds, is protected")
    assert switch_off(service, 0) == (403, "channel 0 is protected: nothing switches it off")
    assert switch_off(service, 4) == (204, "")
    shown = service.api("GET", "/robots/r1/board").json()["channels"]
    assert {one["channel"] for one in shown if one["protected"]} == {0, 3, 7}
    driver = {**config, "protected": ["lamp_d"]}
    assert service.api("PUT", "/robots/r1", json=driver, headers={"If-Match": "*"}).status_code == 200
    seen(service, "on(rail)")
    why = "lamp_d, its driver, which would have to restart after it, is protected"
    assert switch_off(service, 4) == (403, f"channel 4 is protected: {why}")
    assert switch_off(service, 7) == (403, "channel 7 is protected: lamp, which it feeds, is protected")
    assert service.api("PUT", "/robots/r1/board/channels/4", json={"on": True}).status_code == 204
    freed = service.api("PUT", "/robots/r1", json={**config, "protected": []}, headers={"If-Match": "*"})
    assert freed.status_code == 200
    seen(service, "on(rail)")
    assert switch_off(service, 7) == (204, "")


def test_the_global_stop_stops_a_person_s_switch_too(start: StartService, board: int) -> None:
    service = start()
    service.with_robot(board={"host": "127.0.0.1", "port": board, "rate_hz": 20, "protected": []})
    seen(service, "on(jaguar)", "not on(hokuyo)")

    def stop(active: bool) -> None:
        write = service.runtime.store.write
        service.run(write(lambda tx: global_stop.put(tx, active, by="ann", reason="somebody is inside")))

    stop(True)
    refused = service.api("PUT", "/robots/r1/board/channels/3", json={"on": True})
    assert (refused.status_code, refused.json()["detail"]) == (
        403,
        "the global stop is active, set by ann: somebody is inside",
    )
    assert switch_off(service, 7)[0] == 403
    stop(False)
    assert switch_off(service, 7) == (204, "")
    seen(service, "not on(jaguar)", "not on(hokuyo)")  # what was asked during the stop was not done later


def test_a_person_does_not_switch_a_channel_unless_the_robot_is_seen_as_the_model_demands(
    start: StartService, board: int
) -> None:
    service = start()
    service.api("PUT", "/models/fed", json={"source": FED + "properties: [parked]\nact_when: ok(parked)\n"})
    config = {"model": "fed", "board": {"host": "127.0.0.1", "port": board, "rate_hz": 20, "protected": []}}
    assert service.api("PUT", "/robots/r1", json=config).status_code == 201
    seen(service, "on(rail)")
    refused = "act_when of the model, `ok(parked)`, is not what is observed: "
    assert switch_off(service, 4) == (403, refused + "nobody reports ok(parked)")
    service.observe("not ok(parked)")
    on = service.api("PUT", "/robots/r1/board/channels/4", json={"on": True})
    assert (on.status_code, on.json()["detail"]) == (403, refused + "not ok(parked) is observed")
    service.observe("ok(parked)")
    assert switch_off(service, 4) == (204, "")
