"""Who carries out which action, from a robot's configuration."""

from __future__ import annotations

from typing import Any

import pytest

from robomend.errors import InputError
from robomend.repairs.executors.configured import executors
from robomend_client.actions import Action, ActionResult, Feedback

NAMES = ("power_up", "shutdown", "start_node", "stop_node", "reset_usb")
PROGRAMS = {"usb-reset": ("usbreset", "{0}")}


class Double:
    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        raise AssertionError("not called here")


BOARD, AGENT = Double(), Double()


def by(kind: str, **options: Any) -> dict[str, Any]:
    return {"reset_usb": {"executor": {"kind": kind, "options": options}}}


def test_power_goes_to_the_board_and_the_rest_to_the_agent() -> None:
    found = executors(NAMES, {}, board=BOARD, agent=AGENT, programs={})
    assert {name for name, one in found.items() if one is BOARD} == {"power_up", "shutdown"}
    assert {name for name, one in found.items() if one is AGENT} == {"start_node", "stop_node", "reset_usb"}


def test_without_a_board_nobody_switches_power() -> None:
    found = executors(NAMES, {}, board=None, agent=AGENT, programs={})
    assert set(found) == {"start_node", "stop_node", "reset_usb"}


def test_a_board_carries_out_nothing_but_power() -> None:
    found = executors(NAMES, by("board"), board=BOARD, agent=AGENT, programs={})
    assert "reset_usb" not in found


@pytest.mark.parametrize(
    ("configured", "said"),
    [
        (by("process"), "the service's settings name no program 'reset_usb' \\(programs: usb-reset\\)"),
        (by("process", program="rm"), "name no program 'rm'"),
        (by("webhook"), "a webhook needs url and secret"),
        (by("webhook", url="https://h", secret="s", method="GET"), "a webhook needs url and secret"),
        (by("webhook", url="file:///etc/passwd", secret="s"), "is no http or https address"),
    ],
)
def test_options_that_do_not_fit_are_refused(configured: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        executors(NAMES, configured, board=BOARD, agent=AGENT, programs=PROGRAMS)


def test_a_program_of_the_settings_and_a_webhook_are_taken() -> None:
    for configured in (by("process", program="usb-reset"), by("webhook", url="https://h", secret="s")):
        found = executors(NAMES, configured, board=BOARD, agent=AGENT, programs=PROGRAMS)
        assert found["reset_usb"] not in (BOARD, AGENT)
