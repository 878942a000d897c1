"""The bridge as a feed: the section `ros1:` of the agent's file, and who gets what.

topics ──► ticks and fields ──┐
nodes ──► table ──────────────┤
services ──► true or false ───┼──► observers with `from: ros1`
/diagnostics ──► statuses ────┤
/board_measurments ──► channels, currents
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import Any

from robomend_client.actions import BY_COMPONENT
from robomend_client.agent.feeds import AgentParts, Deliver, split
from robomend_client.agent.ring import LARGE, Tap
from robomend_client.bridges.base import DIAGNOSTICS, NAME, NODES, RosBridge, Runs
from robomend_client.bridges.fields import MissingField, UnreadableMessage
from robomend_client.bridges.listening import Listening
from robomend_client.bridges.measured import is_board, measured
from robomend_client.bridges.problems import MIXED_S
from robomend_client.bridges.ros1 import formats
from robomend_client.bridges.ros1.actions import MODEL_SERVER, POWER, ActionServer, ModelServer, RosAction
from robomend_client.bridges.ros1.asking import Ros1Asking
from robomend_client.bridges.ros1.liveness import Liveness
from robomend_client.bridges.ros1.messages import MessageReaders, described
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.services import Services
from robomend_client.bridges.ros1.subscription import Publisher
from robomend_client.bridges.ros1.tcpros import LONGEST_MESSAGE
from robomend_client.bridges.ros1.xmlrpc import OutOfReach, address_of
from robomend_client.bridges.telling import ToldTopic
from robomend_client.observers.meeting import MISMATCHES
from robomend_client.python310 import end
from robomend_client.yaml_reader import Section

MEASUREMENTS = ("board_measurments", "channel")
"""The topic and the field that sources of the board are made of."""

TELLS: dict[str, tuple[str, Callable[..., bytes | None]]] = {
    "observations": (formats.OBSERVATIONS, formats.observations),
    "diagnosis": (formats.DIAGNOSIS, formats.diagnosis),
    "diagnostics": (formats.DIAGNOSTICS, formats.diagnostics),
    "board_measurments": (formats.BOARD, formats.board),
}

SERVICES = "services:"
"""Begins the source of a service: whether it answers."""

MASTER_URI = "http://localhost:11311/"


class Ros1(RosBridge):
    """The feed `ros1`."""

    def __init__(self, section: Section, base: Path, sources: frozenset[str]) -> None:
        super().__init__(section, "ROS 1", TELLS)
        section.explain(
            master="where the ROS master is; by default ROS_MASTER_URI, or http://localhost:11311/",
            address="under which other nodes reach this one; by default ROS_HOSTNAME, ROS_IP, or the address "
            "that faces the master",
            ping_s="a node that was not heard for so many seconds is asked whether it runs",
            ping_timeout_s="one that takes the question and says nothing for three times so many seconds is "
            "frozen; after one where its process, on this computer, is halted",
            serve="names of actions that other nodes may ask for, by an action server of each",
        )
        self.master_uri = section.text("master", os.environ.get("ROS_MASTER_URI") or MASTER_URI)
        try:
            address_of(self.master_uri)
        except OutOfReach as error:
            raise section.error("master", str(error)) from error
        own = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP")
        self.address = section.optional("address") or own
        self.ping_s = section.number("ping_s", 0.6, least=0.05, most=60)
        self.ping_timeout_s = section.number("ping_timeout_s", 1.0, least=0.05, most=60)
        self.serves = section.texts("serve")
        for name in self.serves:
            if not NAME.match(name):
                raise section.error("serve", f"must be names of actions, not {name!r}")
        self._readers = MessageReaders()
        if MISMATCHES in sources:
            raise section.error("", "ROS 1 has no qualities of service: there is nothing for kind: qos")
        self._services: dict[str, str] = {}  # source -> service
        for source in sorted(sources - {NODES}):
            if source.startswith(SERVICES):
                self._services[source] = self.names.ros(source.removeprefix(SERVICES))
                continue
            if source == DIAGNOSTICS:
                self.hear_diagnostics()
                continue
            topic, field = MEASUREMENTS if is_board(source) else split(source)
            self._topics.setdefault(self.topic_of(topic), []).append((source, field))
        self._watches_nodes = NODES in sources
        self._node: RosNode | None = None

    def read_now(self) -> None:
        if self._node is not None:
            self.look(self._node)

    async def run(self, deliver: Deliver) -> None:
        """Be a node of the master, and deliver what it hears, until cancelled."""
        parts = self._parts
        now_ns = time.time_ns if parts is None else parts.clock.now_ns
        node = RosNode(self.node_name, self.master_uri, self.address, self.problems, now_ns)
        self._node, self._deliver = node, deliver
        liveness = self._liveness(node, deliver) if self._watches_nodes else None
        tap = self._tap(partial(described, self._readers))
        for topic, wanted in self._topics.items():
            hears = _Hearing(self, topic, wanted, deliver, liveness, tap)
            up_to = 0 if tap is None or parts is None else LONGEST_MESSAGE if parts.keeps_all else LARGE
            node.subscribe(topic, hears.message, keep=hears.looks, up_to=up_to)
        work = [node.run()]
        if self._services:
            work.append(self._watched(node, deliver).run())
        if liveness is not None:
            work.append(liveness.run())
        work += [self.read_on()] if parts is None else self._with(node, parts)
        tasks = [asyncio.create_task(part) for part in work]
        try:
            await asyncio.gather(*tasks)
        finally:
            self._node = None
            await end(tasks)

    def _with(self, node: RosNode, parts: AgentParts) -> list[Coroutine[Any, Any, None]]:
        """Return what else there is to do as a part of an agent."""
        topics = {name: _topic(node, name, self.told_topic(name)) for name in self.publishes}
        work = [self.tell_by(parts, topics).run()]
        mine = (name for name in parts.executors.names if name not in BY_COMPONENT)
        served = (*mine, *POWER, MODEL_SERVER)
        for name in self.serves:
            if name not in served:
                known = ", ".join(served)
                self.problems.tell(name, f"cannot be served: this agent can do {known}")
                continue
            server = ModelServer if name == MODEL_SERVER else ActionServer
            work.append(server(node, parts, name, self.names.ros(name)).run())
        for executor in parts.executors:
            if isinstance(executor, RosAction | Ros1Asking):
                executor.attach(node)
        if self.hears:
            listening = self.listening(parts, "ros1-observations")

            def said(publisher: Publisher, body: bytes, _: int) -> None:
                self._said(listening, publisher, body)

            node.subscribe(self.names.ros("observations"), said, keep=True)
            work.append(listening.run())
        return work

    def _said(self, listening: Listening, publisher: Publisher, body: bytes) -> None:
        if listening.ignores(publisher.node):
            return
        try:
            sentences = self._readers.open(publisher, body).at("obs")
        except UnreadableMessage as error:
            self.problems.tell(f"/observations by {publisher.node}", str(error))
            return
        listening.heard(publisher.node, map(str, sentences if isinstance(sentences, list) else ()))

    def _watched(self, node: RosNode, deliver: Deliver) -> Services:
        def tell(source: str, answers: bool) -> None:
            deliver(source, answers, None)

        return Services(node, self._services, tell, self.ping_timeout_s)

    def _liveness(self, node: RosNode, deliver: Deliver) -> Liveness:
        def tell(table: dict[str, bool | None]) -> None:
            self.look_at_names(table)
            why = liveness.nodes.why
            told: dict[str, Runs] = {
                name: why(name) if runs is False else runs for name, runs in table.items()
            }
            deliver(NODES, self.table(told), None)

        liveness = Liveness(node, tell, self.ping_s, self.ping_timeout_s)
        return liveness  # what it tells looks into it


def _topic(node: RosNode, name: str, topic: str) -> ToldTopic:
    kind, message = TELLS[name]
    return ToldTopic(node.publish(topic, kind, formats.message_type), message)


class _Hearing:
    """One topic, and the sources that are made of it."""

    def __init__(
        self,
        bridge: Ros1,
        topic: str,
        wanted: list[tuple[str, str]],
        deliver: Deliver,
        liveness: Liveness | None,
        tap: Tap | None,
    ) -> None:
        self._tap = tap
        self._counted = [source for source, field in wanted if not field]
        self._fields = [(source, field, is_board(source)) for source, field in wanted if field]
        self._bridge = bridge
        self._topic = topic
        self._deliver = deliver
        self._liveness = liveness

    @property
    def looks(self) -> bool:
        """Whether anybody looks into the messages."""
        return bool(self._fields)

    def message(self, publisher: Publisher, body: bytes, arrived_ns: int) -> None:
        if self._liveness is not None:
            self._liveness.heard(publisher)
        if self._tap is not None:
            self._tap(self._topic, arrived_ns, body, publisher)
        for source in self._counted:
            self._deliver(source, None, arrived_ns)
        if self._fields:
            self._look(publisher, body, arrived_ns)

    def _look(self, publisher: Publisher, body: bytes, time_ns: int) -> None:
        problems = self._bridge.problems
        place = f"messages of {self._topic} by {publisher.node}"
        try:
            message = self._bridge._readers.open(publisher, body)
            for source, field, of_board in self._fields:
                try:
                    value = message.at(field)
                    if of_board:
                        value = measured(source, value)
                except MissingField as error:
                    problems.tell(f"{self._topic} by {publisher.node}, {field}", str(error))
                else:
                    self._deliver(source, value, time_ns)
        except UnreadableMessage as error:
            problems.tell(place, error)
        else:
            problems.over(place, MIXED_S)
