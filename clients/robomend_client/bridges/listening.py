"""What others' observers say on /observations, handed on to the service like our own verdicts.

Their sentences wait on the disk while the service is away, hold for a lifetime, and are unknown after it.
What agents of robomend say there themselves is not heard: the service has it already.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from fnmatch import fnmatchcase

from robomend_client.agent.feeds import AgentParts
from robomend_client.agent.reporter import VerdictReporter
from robomend_client.beats import beat
from robomend_client.bridges.names import Names, resolved
from robomend_client.bridges.problems import Problems
from robomend_client.bridges.sentences import Sentences, read_sentence
from robomend_client.buffer import DiskBuffer
from robomend_client.observers import ns
from robomend_client.outbox import AsyncOutbox
from robomend_client.python310 import end

SOURCE = "ROS /observations"
LOOK_S = 0.5
"""How often it is looked what nobody repeats; a tenth of the lifetime, if that is less."""


class Listening:
    """Reads /observations."""

    def __init__(
        self,
        parts: AgentParts,
        names: Names,
        problems: Problems,
        lifetime_s: float,
        ignored: tuple[str, ...],
        folder: str,
    ) -> None:
        """`folder`, in the agent's state directory, is where sentences wait; `ignored` are nodes."""
        self._parts = parts
        self._names = names
        self._problems = problems
        self._ignored = ignored
        self._look_s = min(LOOK_S, lifetime_s / 10)
        self._sentences = Sentences(ns(lifetime_s))
        self._buffer = DiskBuffer(parts.state_dir / folder, parts.buffer_bytes)
        self._reporter = VerdictReporter(
            AsyncOutbox(parts.client, parts.robot, self._buffer),
            SOURCE,
            parts.heartbeat_s,
            lifetime_s,
            self._sentences.standing,
            parts.clock,
        )

    def ignores(self, node: str) -> bool:
        """Return whether what this node says is not heard."""
        return any(fnmatchcase(node, pattern) for pattern in self._ignored)

    def heard(self, node: str, sentences: Iterable[str]) -> None:
        """A node has said this."""
        now_ns = self._parts.clock.now_ns()
        for text in sentences:
            try:
                literals = read_sentence(text, lambda name: self._names.ours(resolved(name)))
            except ValueError as error:
                self._problems.tell(f"/observations by {node}", f"not understood: {error}"[:300])
            else:
                self._reporter.report(self._sentences.heard(literals, now_ns))

    async def run(self) -> None:
        """Report until cancelled."""
        report = asyncio.create_task(self._reporter.run())
        try:
            while not report.done():
                await beat(self._look_s)
                self._reporter.report(self._sentences.expired(self._parts.clock.now_ns()))
            report.result()
        finally:
            await end([report])
            self._buffer.close()
