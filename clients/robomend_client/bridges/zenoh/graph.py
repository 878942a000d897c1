"""Who is there, by the tokens: nodes, what they publish and what they listen to. A value, no sockets."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator

from robomend_client.bridges.ros2.names import ros_type
from robomend_client.bridges.zenoh.keys import (
    NODE,
    PUBLISHER,
    SERVER,
    SUBSCRIBER,
    BadKey,
    LivelinessToken,
    gid,
    parse_token,
)
from robomend_client.ros_graph import GOALS_END, RosGraph

MOST_TOKENS = 65536
MOST_NODES = 4096
SOMEBODY = "/unknown_node"
"""Who publishes without a token."""


class Graph:
    """All tokens of a domain that are there, and the nodes that were."""

    def __init__(self) -> None:
        self.own = ""  # our session: what it has is nobody else's
        self._tokens: dict[str, LivelinessToken] = {}
        self._by_gid: dict[bytes, LivelinessToken] = {}
        self._by_topic: dict[str, dict[str, LivelinessToken]] = defaultdict(dict)
        self._ever: dict[str, str] = {}  # node -> its session, the last one

    def add(self, key: str) -> None:
        """Somebody has come.

        Raises:
            BadKey: it is no token of rmw_zenoh.
        """
        token = parse_token(key)
        if len(self._tokens) >= MOST_TOKENS:
            raise BadKey(f"there are more than {MOST_TOKENS} tokens")
        self._tokens[key] = token
        if token.kind == NODE:
            if len(self._ever) < MOST_NODES or token.node in self._ever:
                self._ever[token.node] = token.session
        else:
            self._by_topic[token.topic].pop(key, None)  # the newest comes last
            self._by_topic[token.topic][key] = token
            self._by_gid[gid(key)] = token

    def remove(self, key: str) -> None:
        """Somebody has gone."""
        token = self._tokens.pop(key, None)
        if token is not None and token.kind != NODE:
            self._by_gid.pop(gid(key), None)
            self._by_topic[token.topic].pop(key, None)
            if not self._by_topic[token.topic]:
                del self._by_topic[token.topic]

    # --- what follows from it --------------------------------------------------------------------------

    def publishers(self, topic: str) -> list[LivelinessToken]:
        """Return others' publishers of a topic, the newest last."""
        return [token for token in self._others(topic) if token.kind == PUBLISHER]

    def subscribers(self, topic: str) -> list[LivelinessToken]:
        """Return who else listens to a topic."""
        return [token for token in self._others(topic) if token.kind == SUBSCRIBER]

    def publisher(self, gid: bytes, topic: str, kind: str) -> str:
        """Return the name of the node that has published a message of this type."""
        if (token := self._by_gid.get(gid)) is not None:
            return token.node
        may_be = {token.node for token in self.publishers(topic) if token.type == kind}
        return may_be.pop() if len(may_be) == 1 else SOMEBODY

    def sessions(self) -> set[str]:
        """Return the sessions that have nodes, but for our own."""
        return {t.session for t in self._tokens.values() if t.kind == NODE} - {self.own}

    def session_of(self, node: str) -> str:
        """Return the session that a node has, or had."""
        return self._ever.get(node, "")

    def nodes(self, stopped: Collection[str] = ()) -> dict[str, bool]:
        """Return which of all nodes that ever were run; those of `stopped` sessions do not."""
        table = dict.fromkeys(self._ever, False)
        for token in self._tokens.values():
            if token.kind == NODE and token.session not in stopped:
                table[token.node] = True
        return table

    def graph(self) -> RosGraph:
        """Return it as any ROS graph."""
        kinds = (PUBLISHER, SUBSCRIBER, SERVER)
        tables: dict[str, dict[str, set[str]]] = {kind: defaultdict(set) for kind in kinds}
        types: dict[str, str] = {}
        actions: dict[str, set[str]] = defaultdict(set)
        for token in self._tokens.values():
            if token.kind == PUBLISHER and token.session != self.own and token.topic.endswith(GOALS_END):
                actions[token.topic.removesuffix(GOALS_END)].add(token.node)
            if token.kind in tables and token.session != self.own and "/_action/" not in token.topic:
                tables[token.kind][token.topic].add(token.node)
                if token.kind != SERVER:
                    types[token.topic] = ros_type(token.type)
        publishers, subscribers, services = (
            {name: frozenset(found) for name, found in table.items()} for table in tables.values()
        )
        served = {name: frozenset(found) for name, found in actions.items()}
        return RosGraph(publishers, subscribers, services, types, actions=served)

    def mismatches(self) -> dict[str, str]:
        """Return the topics of which no message goes from a publisher to a subscriber, and why.

        To zenoh any quality of service will do; but messages of another type, or of the same one with
        another definition, have another key.
        """
        found = {}
        for topic in self._by_topic:
            for publisher in self.publishers(topic):
                for subscriber in self.subscribers(topic):
                    if why := _why_not(publisher, subscriber):
                        found[topic] = why
        return found

    def _others(self, topic: str) -> Iterator[LivelinessToken]:
        return (t for t in self._by_topic.get(topic, {}).values() if t.session != self.own)


def _why_not(publisher: LivelinessToken, subscriber: LivelinessToken) -> str:
    if publisher.type != subscriber.type:
        told, wanted = ros_type(publisher.type), ros_type(subscriber.type)
    elif publisher.type_hash != subscriber.type_hash:
        told = wanted = f"{ros_type(publisher.type)} of another definition"
    else:
        return ""
    return f"{publisher.node} publishes {told}, {subscriber.node} asks for {wanted}: no message goes there"
