"""What others' observers say on /observations, handed on to the service like our own verdicts.

Their sentences wait on the disk while the service is away, hold for a lifetime, and are unknown after it.
What agents of robomend say there themselves is not heard: the service has it already.
"""

from __future__ import annotations

import asyncio
from fnmatch import fnmatchcase
from typing import Any

from robomend_client.agent.feeds import AgentParts
from robomend_client.agent.reporter import VerdictReporter
from robomend_client.bridges.ros1.messages import MessageReaders, UnreadableMessage, value_at
from robomend_client.bridges.ros1.names import Names, resolved
from robomend_client.bridges.ros1.problems import Problems
from robomend_client.bridges.ros1.sentences import Sentences, read_sentence
from robomend_client.bridges.ros1.subscription import Publisher
from robomend_client.buffer import DiskBuffer
from robomend_client.observers import ns
from robomend_client.outbox import AsyncOutbox
from robomend_client.python310 import end

SOURCE = "ROS /observations"
FOLDER = "ros1-observations"
LOOK_S = 0.1


class Listening:
    """Reads /observations."""

    def __init__(
        self,
        parts: AgentParts,
        names: Names,
        readers: MessageReaders,
        problems: Problems,
        lifetime_s: float,
        ignored: tuple[str, ...],
    ) -> None:
        self._parts = parts
        self._names = names
        self._readers = readers
        self._problems = problems
        self._ignored = ignored
        self._sentences = Sentences(ns(lifetime_s))
        self._buffer = DiskBuffer(parts.state_dir / FOLDER, parts.buffer_bytes)
        self._reporter = VerdictReporter(
            AsyncOutbox(parts.client, parts.robot, self._buffer),
            SOURCE,
            parts.heartbeat_s,
            lifetime_s,
            self._sentences.standing,
            parts.clock,
        )

    def message(self, publisher: Publisher, body: bytes) -> None:
        """A message came in."""
        if any(fnmatchcase(publisher.node, pattern) for pattern in self._ignored):
            return
        place = f"/observations by {publisher.node}"
        try:
            said: Any = value_at(self._readers.read(publisher, body), "obs")
        except UnreadableMessage as error:
            self._problems.tell(place, str(error))
            return
        now_ns = self._parts.clock.now_ns()
        for text in said if isinstance(said, list) else ():
            try:
                literals = read_sentence(str(text), lambda name: self._names.ours(resolved(name)))
            except ValueError as error:
                self._problems.tell(place, f"not understood: {error}"[:300])
            else:
                self._reporter.report(self._sentences.heard(literals, now_ns))

    async def run(self) -> None:
        """Report until cancelled."""
        report = asyncio.create_task(self._reporter.run())
        try:
            while not report.done():
                await asyncio.sleep(LOOK_S)
                self._reporter.report(self._sentences.expired(self._parts.clock.now_ns()))
            report.result()
        finally:
            await end([report])
            self._buffer.close()
