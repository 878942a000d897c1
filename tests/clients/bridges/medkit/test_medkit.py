"""ros2_medkit as a source of literals and as somebody who restarts, by its documented JSON."""

from __future__ import annotations

import asyncio
import re
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.clients.bridges.hearing import Heard, hearing
from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually, service_double
from tests.medkit_gateway import MedkitGateway, fault, freezable_gateway, medkit_gateway

from robomend_client.actions import FAILED, OK, Action, ActionResult
from robomend_client.agent.config import load
from robomend_client.bridges.medkit.faults import BadFault, Faults, read_fault
from robomend_client.bridges.medkit.gateway import Gateway, NoGateway
from robomend_client.bridges.medkit.restart import Restart
from robomend_client.yaml_reader import ConfigError

LIDAR = fault("LIDAR_RANGE_INVALID", "/sensors/lidar_driver")


@pytest.fixture
def gateway() -> Iterator[MedkitGateway]:
    with medkit_gateway() as found:
        yield found


def levels(heard: Heard) -> dict[str, int]:
    return {status["name"]: status["level"] for status in heard.last("diagnostics") or ()}


# --- faults -------------------------------------------------------------------------------------------------


def test_faults_of_the_list_and_of_the_stream_are_statuses_of_their_entities(
    gateway: MedkitGateway, tmp_path: Path
) -> None:
    gateway.faults = [LIDAR]

    async def test() -> None:
        async with hearing(tmp_path, "medkit", f"url: {gateway.url}\npoll_s: 60", "diagnostics") as heard:
            await heard.until(lambda: levels(heard).get("lidar_driver") == 2, "the fault of the list")
            assert levels(heard)["lidar_driver: LIDAR_RANGE_INVALID"] == 2
            assert (levels(heard)["motor_controller"], levels(heard)["host"]) == (0, 0)
            gateway.happens("fault_confirmed", fault("HOT", "/a/motor_controller", 1), "motor_controller")
            await heard.until(lambda: levels(heard).get("motor_controller") == 1, "a warning of the stream")
            gateway.happens("fault_cleared", {**LIDAR, "status": "CLEARED"})
            await heard.until(lambda: levels(heard)["lidar_driver"] == 0, "it was cleared")
            assert levels(heard)["lidar_driver: LIDAR_RANGE_INVALID"] == 0
            assert heard.log == []

    asyncio.run(test())


def test_a_gateway_that_takes_the_question_and_says_nothing_is_told_in_words() -> None:
    async def test(port: int) -> None:
        gateway = Gateway(f"http://127.0.0.1:{port}/api/v1", None, 0.1)
        try:
            with pytest.raises(NoGateway, match=r"^/apps: no answer in time$"):
                await gateway.get("/apps")
        finally:
            await gateway.close()

    with socket.create_server(("127.0.0.1", 0)) as frozen:
        asyncio.run(test(frozen.getsockname()[1]))


def test_a_gateway_that_goes_is_told_once_and_its_stream_goes_on_where_it_was(
    gateway: MedkitGateway, tmp_path: Path
) -> None:
    async def test() -> None:
        async with hearing(tmp_path, "medkit", f"url: {gateway.url}\npoll_s: 0.2", "diagnostics") as heard:
            gateway.faults = [fault("HOT", "/motor_controller", 1)]
            gateway.happens("fault_updated", gateway.faults[0])
            await heard.until(lambda: levels(heard).get("motor_controller") == 1, "a warning")
            await asyncio.to_thread(gateway.down)
            await heard.told("the gateway: ")
            said = heard.count("diagnostics")
            await asyncio.to_thread(gateway.up)
            await heard.told("the gateway: well again")
            await heard.until(lambda: heard.count("diagnostics") > said, "more")
            await heard.until(lambda: ("GET", "/faults/stream", "1") in gateway.asked, "where it was")

    asyncio.run(test())


def test_of_a_gateway_that_is_halted_nothing_is_known_and_nothing_said(tmp_path: Path) -> None:
    """It takes connections, as its system does for it, and answers nothing."""
    with freezable_gateway() as gateway:

        async def test() -> None:
            keys = f"url: {gateway.url}\npoll_s: 0.5"
            async with hearing(tmp_path, "medkit", keys, "diagnostics") as heard:
                await heard.until(
                    lambda: heard.count("diagnostics") and heard.sees("diagnostics"), "statuses"
                )
                gateway.halt()
                await heard.until(lambda: not heard.sees("diagnostics"), "nobody looks")
                said = heard.count("diagnostics")
                await heard.told("the gateway: /apps: no answer in time")
                assert heard.count("diagnostics") == said
                gateway.go_on()
                await heard.until(lambda: heard.sees("diagnostics"), "somebody looks again")
                await heard.more("diagnostics")

        asyncio.run(test())


def test_without_the_stream_a_fault_that_is_over_is_known_within_a_second_or_two(
    gateway: MedkitGateway, tmp_path: Path
) -> None:
    """What is said each second must not be as old as the last list of everything."""
    gateway.answers["/faults/stream"] = (503, b"{}")  # it serves two clients only
    gateway.faults = [LIDAR]

    async def test() -> None:
        async with hearing(tmp_path, "medkit", f"url: {gateway.url}\npoll_s: 3600", "diagnostics") as heard:
            await heard.until(lambda: levels(heard).get("lidar_driver") == 2, "the fault")
            gateway.faults = []
            await heard.until(lambda: levels(heard)["lidar_driver"] == 0, "it is over")
            await heard.told("the stream: /faults/stream is answered with 503")
            assert len(heard.log) == 1

    asyncio.run(test())


@pytest.mark.parametrize(("told", "stream"), [("ids", True), ("nodes", False)])
def test_of_two_nodes_of_one_name_the_one_whose_fault_it_is_stays_bad(
    told: str, stream: bool, gateway: MedkitGateway, tmp_path: Path
) -> None:
    nodes = {"/robot1/lidar_driver": "robot1_lidar_driver", "/robot2/lidar_driver": "robot2_lidar_driver"}
    if told == "nodes":  # the ids say nothing
        nodes = {"/robot1/lidar_driver": "front", "/robot2/lidar_driver": "lidar_driver"}
        gateway.nodes = {entity: node for node, entity in nodes.items()}
    gateway.apps = list(nodes.values())
    one, other = nodes.values()
    bad = fault("LIDAR_RANGE_INVALID", "/robot1/lidar_driver")

    async def test() -> None:
        async with hearing(tmp_path, "medkit", f"url: {gateway.url}\npoll_s: 0.2", "diagnostics") as heard:
            await heard.until(lambda: heard.count("diagnostics"), "statuses")
            gateway.faults = [bad]
            if stream:
                gateway.happens("fault_confirmed", bad, one)
            await heard.until(lambda: levels(heard).get(one) == 2, "the fault")
            for _ in range(5):  # lists that come after the event
                await heard.more("diagnostics", 1)
                assert (levels(heard)[one], levels(heard)[other]) == (2, 0)
            assert set(levels(heard)) == {one, other, "host", f"{one}: LIDAR_RANGE_INVALID"}
            assert heard.log == []

    asyncio.run(test())


def test_all_who_report_a_fault_are_bad_by_list_and_by_event(gateway: MedkitGateway, tmp_path: Path) -> None:
    both = {**LIDAR, "reporting_sources": ["/sensors/lidar_driver", "/base/motor_controller"]}

    async def test() -> None:
        async with hearing(tmp_path, "medkit", f"url: {gateway.url}\npoll_s: 60", "diagnostics") as heard:
            await heard.until(lambda: heard.count("diagnostics"), "statuses")
            gateway.happens("fault_updated", both, "lidar_driver")
            bad = {"lidar_driver": 2, "motor_controller": 2}
            await heard.until(lambda: bad.items() <= levels(heard).items(), "both, by the event")
        gateway.faults = [both]
        async with hearing(tmp_path, "medkit", f"url: {gateway.url}\npoll_s: 60", "diagnostics") as heard:
            await heard.until(lambda: bad.items() <= levels(heard).items(), "both, by the list")

    asyncio.run(test())


def test_garbage_is_told_with_its_place_and_the_rest_is_heard(gateway: MedkitGateway, tmp_path: Path) -> None:
    gateway.faults = [{"severity": "ERROR"}, 3, LIDAR, fault("LOST", "/nobody")]
    gateway.say("fault_confirmed", b"[1, 2")
    gateway.say("fault_confirmed", b'{"fault": 3}')

    async def test() -> None:
        async with hearing(tmp_path, "medkit", f"url: {gateway.url}\npoll_s: 0.2", "diagnostics") as heard:
            await heard.until(lambda: levels(heard).get("lidar_driver") == 2, "the fault that is one")
            await heard.told("an event: 'fault_confirmed' is no object")
            await heard.told("a fault: no fault: 3")
            await heard.told("entity nobody: has the fault LOST, and the gateway does not list it")
            assert levels(heard)["nobody"] == 2
            gateway.answers["/faults"] = (200, b"<html>")
            await heard.told("the gateway: /faults is no JSON")
            gateway.answers["/faults"] = (200, b'{"items": 3}')
            await heard.told("the gateway: /faults has no list of items")
            assert len(heard.lines("entity nobody")) == 1

    asyncio.run(test())


def test_faults_reach_the_service_as_literals(gateway: MedkitGateway, tmp_path: Path) -> None:
    gateway.faults = [LIDAR]
    sections: dict[str, Any] = {
        "medkit": {"url": gateway.url},
        "observers": {
            name: {"kind": "diagnostic", "from": "medkit", "status": [entity]}
            for name, entity in {"lidar": "lidar_driver", "motor": "motor_controller"}.items()
        },
    }
    with service_double() as service, agent(config(tmp_path, service.url, {}, **sections)):
        wanted = {"ok(lidar)": False, "ok(motor)": True}
        eventually(lambda: wanted.items() <= service.holds().items(), "both", 60)


def test_faults_of_the_documentations_short_form_are_read() -> None:
    told = {"fault_code": "X", "severity": "CRITICAL", "message": "why", "source": "lidar_driver"}
    read = read_fault(told)
    assert (read.level, read.message, read.sources, read.active) == (2, "why", ("lidar_driver",), True)
    assert not read_fault({**told, "status": "HEALED"}).active
    for bad in ({**told, "severity": 7}, {**told, "severity": True}, {**told, "source": [1]}, {}, None):
        with pytest.raises(BadFault):
            read_fault(bad)


json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.text(max_size=5)),
    lambda inside: st.one_of(st.lists(inside, max_size=3), st.dictionaries(st.text(max_size=5), inside)),
    max_leaves=8,
)


@given(st.fixed_dictionaries({}, optional=dict.fromkeys(LIDAR, json_values)))
def test_garbage_is_no_fault_and_nothing_else_happens(value: dict[str, Any]) -> None:
    faults = Faults()
    with suppress(BadFault):
        faults.event("fault_confirmed", read_fault(value))
    faults.statuses()


# --- the restart --------------------------------------------------------------------------------------------


def do(gateway: MedkitGateway, **more: Any) -> ActionResult:
    restart = Restart("restart_node", {"lidar": "apps/lidar_driver"}, gateway.url, **more)
    action = Action("r:1", "restart_node", ("lidar",), 10.0)
    return asyncio.run(restart.execute(action, lambda number, message: None))


def test_an_entity_is_restarted_and_it_is_waited_until_it_is_ready(
    gateway: MedkitGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MEDKIT_TOKEN", "secret")
    gateway.states["apps/lidar_driver"] = ["ready", "notReady", "notReady", "ready"]
    assert do(gateway, token_env="MEDKIT_TOKEN").code == OK
    assert gateway.asked[0] == ("PUT", "/apps/lidar_driver/status/restart", "Bearer secret")
    assert len(gateway.asked) == 5


@pytest.mark.parametrize(
    ("transition", "states"), [("restart", ["ready"]), ("shutdown", ["ready", "notReady"])]
)
def test_an_entity_that_was_faster_than_one_looks_is_restarted_and_one_is_shut_down(
    transition: str, states: list[str], gateway: MedkitGateway
) -> None:
    gateway.states["apps/lidar_driver"] = states
    assert do(gateway, transition=transition).code == OK


@pytest.mark.parametrize(
    ("code", "why"),
    [
        (403, "the token's role may not do that (403)"),
        (501, "nobody at the gateway can do that to the entity (501)"),
        (500, "the gateway refuses it (500)"),
    ],
)
def test_a_gateway_that_refuses_fails_the_action_and_says_why(
    code: int, why: str, gateway: MedkitGateway
) -> None:
    gateway.answers["/apps/lidar_driver/status/restart"] = (code, b"{}")
    result = do(gateway)
    assert (result.code, why in result.message) == (FAILED, True)
    gateway.down()
    assert do(gateway).code == FAILED


# --- the agent's file ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sections", "complaint"),
    [
        ({"medkit": {"poll_s": 0}}, "medkit.poll_s: must be from 0.1"),
        ({"topics": {"scan": {"from": "medkit"}}}, "medkit.url: the gateway has one source, diagnostics"),
        ({"actions": {"a": {"kind": "medkit", "entities": {"x": "apps/../y"}}}}, "is no entity"),
        ({"actions": {"a": {"kind": "medkit", "entities": {"x": "apps/y"}, "transition": ""}}}, "transition"),
    ],
)  # fmt: skip
def test_a_bad_file_is_refused_with_file_line_and_key(
    sections: dict[str, Any], complaint: str, tmp_path: Path
) -> None:
    file = config(tmp_path, "http://127.0.0.1:1", {}, **sections)
    with pytest.raises(ConfigError, match=re.escape(complaint)) as refused:
        load(file)
    assert str(refused.value).startswith(f"{file}:1: ")
