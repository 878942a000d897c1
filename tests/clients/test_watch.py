"""The agent's observers and its clock."""

from __future__ import annotations

import pytest

from robomend_client.agent.watch import Watch
from robomend_client.clock import Clock
from robomend_client.observers import GeneralObserver


def test_a_feed_that_cannot_be_read_is_told_once_and_the_others_are_read_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Reading:
        reads = 0

        def read_now(self) -> None:
            self.reads += 1

    class Broken(Reading):
        def read_now(self) -> None:
            super().read_now()
            raise ZeroDivisionError("mine")

    broken, good = Broken(), Reading()
    watch = Watch([GeneralObserver("scan")], Clock(), lambda changes: None)
    watch.read(broken, ["scan"])
    watch.read(good, [])
    for n in range(3):
        watch.settle(n, ())
    assert (broken.reads, good.reads) == (1, 3)
    assert [record.message for record in caplog.records] == [
        "the feed Broken failed, and is not read any more"
    ]
