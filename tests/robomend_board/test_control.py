"""The control port: what a test, a person or a simulated device may ask."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.robomend_board.processes import Control, RawClient, Running, running


@pytest.fixture(scope="module")
def emulator() -> Iterator[Running]:
    with running("--on", "2") as emulator:
        yield emulator


@pytest.fixture
def control(emulator: Running) -> Iterator[Control]:
    with Control(emulator.control_port) as control:
        yield control


def test_the_status_tells_channels_faults_and_clients(emulator: Running, control: Control) -> None:
    with RawClient(emulator.port) as client:
        client.frame()
        client.ask("02 01 01 00 05")
        control.ask(fault="stuck", channel=7)
        control.ask(fault="late", delay_s=0.25)
        status = control.ask(status=True)
        assert [channel["channel"] for channel in status["channels"]] == list(range(10))
        pc = status["channels"][2]
        assert (pc["name"], pc["on"], pc["powered"]) == ("pc", True, True)
        assert pc["current_a"] > 0
        assert status["faults"] == [
            {"fault": "stuck", "channel": 7, "at": "off"},
            {"fault": "late", "delay_s": 0.25},
        ]
        assert [client["broadcast_hz"] for client in status["clients"]] == [5]
    assert control.ask(clear="all") == {"ok": True}
    assert control.ask(status=True)["faults"] == []


def test_one_that_watches_gets_every_channel_and_then_every_change(
    emulator: Running, control: Control
) -> None:
    assert control.ask(watch=True) == {"ok": True, "watching": True}
    first = [control.line() for _ in range(10)]
    assert [(line["channel"], line["on"]) for line in first] == [(n, n == 2) for n in range(10)]
    with RawClient(emulator.port) as client, Control(emulator.control_port) as other:
        client.frame()
        client.ask("02 04 02 00 07 01")
        assert other.ask(set={"channel": 7, "on": False}) == {"ok": True}
        assert other.ask(set={"channel": 7, "on": False}) == {"ok": True}  # no change, no line
        other.ask(fault="open", channel=2)
        other.ask(clear="open", channel=2)
    changes = [control.line() for _ in range(4)]
    assert [(line["channel"], line["on"], line["powered"]) for line in changes] == [
        (7, True, True),
        (7, False, False),
        (2, True, False),
        (2, True, True),
    ]
    assert all(isinstance(line["time_ns"], int) for line in (*first, *changes))


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("hello", "a JSON object with one of the keys fault, clear, set, status, watch"),
        ("\x00h\x00i", "a JSON object with one of the keys"),  # json would take it for UTF-16
        ("[" * 5000, "a JSON object with one of the keys"),
        ('{"status": true, "watch": true}', "one of the keys"),
        ('{"fault": "gremlins"}', "there are stuck"),
        ('{"clear": ["all"]}', "and all"),
        ('{"set": {"channel": 7}}', '"on": false'),
        ('{"set": 7}', '"on": false'),
        ('{"set": {"channel": 12, "on": true}}', "0 to 9"),
        ('{"status": true, "of": 7}', "of: not a key"),
    ],
)
def test_a_wrong_request_is_told_what_is_right_and_the_port_goes_on(
    control: Control, line: str, says: str
) -> None:
    control.say(line)
    answer = control.line()
    assert answer["ok"] is False
    assert says in answer["error"]
    assert control.ask(status=True)["ok"]


def test_a_line_without_end_is_refused(emulator: Running, control: Control) -> None:
    with Control(emulator.control_port) as vandal:
        vandal.say('{"status": "' + "x" * 100_000)
        assert "one line" in vandal.line()["error"]
    assert control.ask(status=True)["ok"]
