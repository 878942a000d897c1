"""What a drill does to topics of the local bus: messages are dropped, or held back and then come in bunches.

    topic-dropped    nothing of the topic reaches observers or subscribers
    topic-delayed    messages wait until BUNCH_S after the first one, then come all at once, in their order,
                     as over a line that is too slow

They are of the broker, in memory: an agent that ends takes them along.
"""

from __future__ import annotations

import asyncio
from collections import deque

from robomend_client.agent.broker import Broker, TopicMessage

DROPPED, DELAYED = "topic-dropped", "topic-delayed"
TOPIC_KINDS = (DROPPED, DELAYED)

BUNCH_S = 2.0
"""Longer than the silence that observers usually take for a fault."""

MOST_HELD = 10_000
"""Messages of one topic; the newest are dropped beyond, as for any subscriber that is too slow."""

MOST_BYTES = 4 * 1024 * 1024


class TopicFaults:
    """The disturbed topics of one bus; belongs to its event loop."""

    def __init__(self, broker: Broker, topics: tuple[str, ...]) -> None:
        """`topics` are those that may be disturbed."""
        self.topics = topics
        self._broker = broker
        self._held: dict[str, deque[tuple[TopicMessage, bytes]]] = {}
        self._bytes = 0
        self._timers: dict[str, asyncio.TimerHandle] = {}

    def plant(self, topic: str, kind: str) -> None:
        """Disturb a topic from now on."""
        if kind == DROPPED:
            self._broker.divert(topic, _nowhere)
        else:
            self._held[topic] = deque()
            self._broker.divert(topic, lambda message, line: self._hold(topic, message, line))

    def undo(self, topic: str) -> None:
        """Let it pass again, what was held back first; nothing happens to one that is not disturbed."""
        self._broker.divert(topic, None)
        if (timer := self._timers.pop(topic, None)) is not None:
            timer.cancel()
        if topic in self._held:
            self._release(topic)
            del self._held[topic]

    def _hold(self, topic: str, message: TopicMessage, line: bytes) -> None:
        held = self._held[topic]
        if len(held) >= MOST_HELD or self._bytes + len(line) > MOST_BYTES:
            self._broker.dropped += 1
            return
        if not held:
            self._timers[topic] = asyncio.get_running_loop().call_later(BUNCH_S, self._release, topic)
        held.append((message, line))
        self._bytes += len(line)

    def _release(self, topic: str) -> None:
        held = self._held[topic]
        while held:
            message, line = held.popleft()
            self._bytes -= len(line)
            self._broker.deliver(message, line)


def _nowhere(message: TopicMessage, line: bytes) -> None:
    """Drop a message."""
