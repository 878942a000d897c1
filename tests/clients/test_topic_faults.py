"""A drill's faults of the local bus: one topic is dropped or held back, until that is undone."""

from __future__ import annotations

import asyncio

import pytest

from robomend_client.agent import planted as topic_faults
from robomend_client.agent.broker import Broker, TopicMessage
from robomend_client.agent.planted import DELAYED, DROPPED, TopicFaults
from robomend_client.python310 import timeout

pytestmark = pytest.mark.anyio


class Heard:
    """A broker without a socket, and what its observers hear."""

    def __init__(self) -> None:
        self.topics: list[str] = []
        self.broker = Broker("tcp:127.0.0.1:0", lambda message: self.topics.append(message.topic))
        self.faults = TopicFaults(self.broker, ("scan",))

    def publish(self, *topics: str) -> None:
        for topic in topics:
            self.broker.publish(TopicMessage(topic), b"{}\n")


async def test_a_dropped_topic_reaches_nobody_and_the_others_do() -> None:
    heard = Heard()
    heard.faults.plant("scan", DROPPED)
    heard.publish("scan", "/scan", "odom")
    assert heard.topics == ["odom"]
    heard.faults.undo("scan")
    heard.publish("scan")
    assert heard.topics == ["odom", "scan"]


async def test_a_delayed_topic_comes_in_bunches_and_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topic_faults, "BUNCH_S", 0.05)
    heard = Heard()
    heard.faults.plant("scan", DELAYED)
    for _ in range(2):  # the second bunch has its own time
        before = len(heard.topics)
        heard.publish("scan", "odom", "/scan")
        assert heard.topics[before:] == ["odom"]
        async with timeout(30):
            while len(heard.topics) < before + 3:
                await asyncio.sleep(0.005)
        assert heard.topics[before:] == ["odom", "scan", "/scan"]


async def test_what_is_held_back_is_handed_on_when_the_delay_is_undone() -> None:
    heard = Heard()
    heard.faults.plant("scan", DELAYED)
    heard.publish("scan", "scan")
    heard.faults.undo("scan")
    assert heard.topics == ["scan", "scan"]
    heard.publish("scan")
    assert len(heard.topics) == 3
    heard.faults.undo("scan")  # again, and of what was never planted
    heard.faults.undo("odom")


async def test_what_is_held_back_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = Heard()
    for name, most in (("MOST_HELD", 2), ("MOST_BYTES", 5)):
        with monkeypatch.context() as patch:
            patch.setattr(topic_faults, name, most)
            heard.topics.clear()
            heard.faults.plant("scan", DELAYED)
            heard.publish(*["scan"] * 4)
            heard.faults.undo("scan")
            assert len(heard.topics) < 3
    assert heard.broker.dropped > 3
