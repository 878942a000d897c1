"""The agent's observers and its clock."""

from __future__ import annotations

import logging
import time

import pytest

from robomend_client.agent.watch import Watch
from robomend_client.clock import Clock
from robomend_client.observers import SECOND, GeneralObserver


def test_a_clock_that_is_set_ahead_is_told_also_while_the_agent_was_late(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    wall_ns, mono_ns = [1_800_000_000 * SECOND], [SECOND]
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns[0])
    monkeypatch.setattr(time, "monotonic_ns", lambda: mono_ns[0])
    watch = Watch([GeneralObserver("scan")], Clock(), lambda changes: None)

    def later(by_s: float, set_ahead_s: float = 0.0) -> None:
        mono_ns[0] += round(by_s * SECOND)
        wall_ns[0] += round((by_s + set_ahead_s) * SECOND)
        watch.standing()

    with caplog.at_level(logging.DEBUG, "robomend_client.agent.watch"):
        later(0.05)
        later(5.0)  # nobody looked
        later(5.0, set_ahead_s=600.0)
        later(0.05, set_ahead_s=60.0)
    assert [(record.levelname, record.message) for record in caplog.records] == [
        ("DEBUG", "nobody looked for 5.00 s"),
        ("WARNING", "the clock was set ahead by 600.0 s"),
        ("WARNING", "the clock was set ahead by 60.0 s"),
    ]
