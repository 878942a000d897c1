"""The published formats: md5 sums of the real packages, and what a diagnosis looks like in them."""

from __future__ import annotations

import subprocess
from typing import Any

import pytest
from tests.packages import ROS1_PYTHON
from tests.ros1 import ros1

from robomend_client.bridges.ros1 import formats


def test_the_md5_sums_are_those_of_the_distributions_packages() -> None:
    ros1()
    code = "from diagnostic_msgs.msg import DiagnosticArray as D; print(D._md5sum)"
    done = subprocess.run([ROS1_PYTHON, "-c", code], capture_output=True, text=True, check=True)
    assert formats.message_type(formats.DIAGNOSTICS).md5 == done.stdout.strip()


@pytest.mark.parametrize(
    ("name", "md5"),
    [
        (formats.OBSERVATIONS, "4edcd7df21664f6bbdcc4e7d96307ac3"),
        (formats.DIAGNOSIS, "1a2002a6f57e647d108be3b4d120bbb7"),
        (formats.BOARD, "4824daab1e9545346b582551fc8fa86b"),
    ],
)
def test_the_md5_sums_of_the_published_system(name: str, md5: str) -> None:
    assert formats.message_type(name).md5 == md5


def test_a_message_in_bytes() -> None:
    expected = bytes.fromhex("0000803f 02000000 08000000") + b"ok(scan)" + b"\x05\x00\x00\x00on(j)"
    assert formats.observations(["ok(scan)", "on(j)"], 1_000_000_000) == expected


def result(*bad: list[str], complete: bool = True) -> dict[str, Any]:
    diagnoses = [{"bad": names, "good": sorted({"a", "b", "c"} - set(names)), "text": ""} for names in bad]
    conflicts = [{"components": ["a"], "text": "scan is silent"}]
    return {"diagnoses": diagnoses, "complete": complete, "conflicts": conflicts}


def levels(found: dict[str, Any] | None) -> dict[str, int]:
    message = formats.decode(formats.DIAGNOSTICS, formats.diagnostics(found, "why", 1))
    return {status.name: status.level for status in message.status}


def test_levels_say_how_sure_the_diagnosis_is() -> None:
    assert levels(result([])) == {"robomend: a": 0, "robomend: b": 0, "robomend: c": 0}
    assert levels(result(["a"])) == {"robomend: a": 2, "robomend: b": 0, "robomend: c": 0}
    assert levels(result(["a", "b"], ["a", "c"])) == {"robomend: a": 2, "robomend: b": 1, "robomend: c": 1}
    assert (
        levels(result(["a"], complete=False))["robomend: a"] == 1
    )  # others may be found that do not blame it
    assert levels(None) == {"robomend": 3}


def test_a_channel_of_which_nothing_is_known_has_no_row() -> None:
    channel = {"channel": 3, "component": None, "on": True, "current_a": 1.5, "voltage_v": 24.0}
    body = formats.board([channel, {**channel, "channel": 4, "on": None}], 0)
    (row,) = formats.decode(formats.BOARD, body).channel
    assert (row.id, row.dev_connected, row.status, row.current, row.voltage) == (3, "", 1, 1.5, 24.0)
