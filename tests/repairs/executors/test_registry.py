"""Who carries out which action, from a robot's configuration."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import pytest
from tests.repairs.executors.test_board import quiet

from robomend.board.link import BoardLink
from robomend.errors import InputError
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.executors.registry import Once, Surroundings, check, executors
from robomend.robots.boards import WiredBoard
from robomend_client.actions import Action, ActionResult, Feedback

NAMES = ("power_up", "shutdown", "start_node", "stop_node", "reset_usb")


class Board:
    """What an executor asks of a wired board."""

    components: Mapping[int, str] = {3: "lidar"}
    protected = frozenset({2})
    link = cast(BoardLink, None)


AROUND = Surroundings(
    robot="r1",
    board=cast(WiredBoard, Board()),
    agents=cast(AgentQueue, None),
    hosts={},
    programs={"usb-reset": ("usbreset", "{0}")},
    webhook_hosts=(),
    halt=asyncio.Event(),
)


def by(kind: str, **options: Any) -> dict[str, Any]:
    return {"reset_usb": {"executor": {"kind": kind, "options": options}}}


@pytest.mark.parametrize(
    ("configured", "said"),
    [
        (by("process"), "the service's settings name no program 'reset_usb' \\(programs: usb-reset\\)"),
        (by("process", program="rm"), "name no program 'rm'"),
        (by("process", program="usb-reset", arguments=["--exec=sh"]), "takes `program`, .* and nothing else"),
        (by("webhook"), "a webhook needs url and secret"),
        (by("webhook", url="https://h", secret="s", method="GET"), "a webhook needs url and secret"),
        (by("webhook", url="file:///etc/passwd", secret="s"), "is no http or https address"),
        (by("webhook", url="ftp://h/", secret="s"), "is no http or https address"),
        (by("webhook", url="http://", secret="s"), "is no http or https address with a host"),
        (by("webhook", url="https://h:port/", secret="s"), "'https://h:port/': "),
        (by("webhook", url="https://ann:pw@h/", secret="s"), "no user and password in an address"),
        (by("webhook", url="http://10.0.0.1/", secret="s"), "10.0.0.1 is a private address"),
        (by("webhook", url="http://localhost/", secret="s"), "localhost is a private address"),
        (by("webhook", url="http://[::1]:80/", secret="s"), "::1 is a private address"),
        *(
            (by("webhook", url=f"http://{host}/", secret="s"), "is a private address")
            for host in ("127.1", "2130706433", "0x7f000001", "0177.0.0.1", "0", "127.0.0.1.", "localhost.")
        ),
        (by("webhook", url="http://\uff11\uff12\uff17.0.0.1/", secret="s"), "is a private address"),
        (by("webhook", url="http://127\u30020\u30020\u30021/", secret="s"), "is a private address"),
        (by("webhook", url="http://\u24dbocalhost/", secret="s"), "is a private address"),
        (by("webhook", url="http://h.example/\r\nX: y", secret="s"), "control characters"),
        (by("webhook", url="http://h .example/", secret="s"), "no spaces"),
        (by("webhook", url="http://h.example:0/", secret="s"), "no http or https address"),
        (by("webhook", url="http://h.example/", secret="s", allow_private=True), "webhook_hosts"),
    ],
)
def test_what_cannot_work_is_refused_when_it_is_configured(configured: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=f"actions.reset_usb: .*{said}"):
        check(configured, AROUND)
    with pytest.raises(InputError, match=said):  # and where it is stored already
        executors(NAMES, configured, AROUND)


@pytest.mark.parametrize("hosts", [("10.0.0.1",), ("10.0.0.1:8080",)])
def test_a_private_address_is_called_where_the_settings_name_its_host(hosts: tuple[str, ...]) -> None:
    around = replace(AROUND, webhook_hosts=hosts)
    check(by("webhook", url="http://10.0.0.1:8080/", secret="s"), around)
    with pytest.raises(InputError, match="private"):
        check(by("webhook", url="http://10.0.0.2:8080/", secret="s"), around)


# --- a repeated action id gets the first result


class Counting:
    """Answers with how often it was called."""

    def __init__(self) -> None:
        self.calls = 0
        self.let_go = asyncio.Event()

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        self.calls += 1
        await self.let_go.wait()
        return ActionResult(self.calls, action.id)


@pytest.mark.anyio
async def test_the_second_call_gets_the_first_result() -> None:
    inner = Counting()
    inner.let_go.set()
    once = Once(inner)
    action = Action("r-1:0", "power_up", ("lidar",), 1.0)
    assert await once.execute(action, quiet) == await once.execute(action, quiet) == ActionResult(1, "r-1:0")
    assert inner.calls == 1


@pytest.mark.anyio
async def test_a_call_during_the_first_waits_for_it() -> None:
    inner = Counting()
    once = Once(inner)
    action = Action("r-1:0", "power_up", ("lidar",), 1.0)
    both = [asyncio.create_task(once.execute(action, quiet)) for _ in range(2)]
    await asyncio.sleep(0)
    inner.let_go.set()
    assert {result.code for result in await asyncio.gather(*both)} == {1}


@pytest.mark.anyio
async def test_a_cancelled_call_leaves_no_result() -> None:
    inner = Counting()
    once = Once(inner)
    action = Action("r-1:0", "power_up", ("lidar",), 1.0)
    task = asyncio.create_task(once.execute(action, quiet))
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait([task])
    inner.let_go.set()
    assert (await once.execute(action, quiet)).code == 2
