"""The ROS master's calls, with their answers checked."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

from robomend_client.bridges.ros1.xmlrpc import CALL_S, CallRefused, Garbage, call, fetch, read_answer
from robomend_client.ros_graph import RosGraph, Table


class Master:
    """The master at `uri`, as the node `caller` sees it. Every method may raise PeerError."""

    def __init__(self, uri: str, caller: str) -> None:
        self.uri = uri
        self._caller = caller
        self._state = b""  # the newest answer with the state, and what it says
        self._graph = RosGraph()

    async def register_subscriber(self, topic: str, api: str) -> list[str]:
        """Say that we listen; return the addresses of the topic's publishers."""
        return _texts(await self._ask("registerSubscriber", topic, "*", api))

    async def register_publisher(self, topic: str, type_: str, api: str) -> list[str]:
        """Say that we publish; return the addresses of the topic's subscribers."""
        return _texts(await self._ask("registerPublisher", topic, type_, api))

    async def unregister(self, topic: str, api: str, publisher: bool) -> None:
        """Take a registration back."""
        await self._ask("unregisterPublisher" if publisher else "unregisterSubscriber", topic, api)

    async def lookup_node(self, node: str) -> str | None:
        """Return the address of a node, None if the master knows of none."""
        try:
            return str(await self._ask("lookupNode", node))
        except CallRefused:
            return None

    async def lookup_service(self, service: str) -> str | None:
        """Return the address of a service, None if the master knows of none."""
        try:
            return str(await self._ask("lookupService", service))
        except CallRefused:
            return None

    async def parameter(self, name: str) -> Any:
        """Return a parameter of the parameter server, None if it has none of this name."""
        try:
            return await self._ask("getParam", name)
        except CallRefused:
            return None

    async def set_parameter(self, name: str, value: Any) -> None:
        """Set a parameter of the parameter server."""
        await self._ask("setParam", name, value)

    async def graph(self, types: bool = True) -> RosGraph:
        """Return who publishes, listens to and offers what, and the types of the topics."""
        answer = await fetch(self.uri, "getSystemState", self._caller)
        if not types and answer == self._state:
            return self._graph  # to read it is most of what this costs, and mostly it is the same
        state = _value("getSystemState", read_answer("getSystemState", answer))
        kinds = await self._ask("getTopicTypes") if types else []
        try:
            graph = read_state(state, kinds)
        except (TypeError, ValueError) as error:
            raise Garbage(f"the master's state cannot be read: {error}") from error
        if not types:
            self._state, self._graph = answer, graph
        return graph

    async def _ask(self, method: str, *arguments: Any) -> Any:
        return _value(method, await call(self.uri, method, self._caller, *arguments, timeout_s=CALL_S))


def read_graph(uri: str) -> RosGraph:
    """Return the graph of a running robot, without being one of its nodes.

    Raises:
        PeerError: the master does not answer, or not as one.
    """
    return asyncio.run(Master(uri, "/robomend_model").graph())


def read_state(state: Any, types: Any) -> RosGraph:
    """Return the graph of what `getSystemState` and `getTopicTypes` answer.

    Raises:
        TypeError, ValueError: they are not of the shape they should be.
    """
    publishers, subscribers, services = map(_table, state)
    return RosGraph(publishers, subscribers, services, {str(topic): str(kind) for topic, kind in types})


def _value(method: str, answer: Any) -> Any:
    match answer:
        case [1, _, value]:
            return value
        case [int(), str(why), _]:
            raise CallRefused(f"{method}: {why[:200]}")
    raise Garbage(f"{method} was answered with {str(answer)[:200]!r}")


def _table(rows: Iterable[Any]) -> Table:
    return {str(name): frozenset(map(str, nodes)) for name, nodes in rows}


def _texts(value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise Garbage(f"a list of addresses was expected, not {str(value)[:200]!r}")
    return value
