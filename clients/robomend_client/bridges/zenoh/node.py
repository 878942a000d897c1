"""The bridge as a node of ROS 2 over zenoh: what it listens to, what it tells, and its place in the graph.

`read_now`   who has come and gone? what has come in? ──► whoever wants the topic
"""

from __future__ import annotations

import asyncio
import time

from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros2.base import OnMessage, Unheard
from robomend_client.bridges.zenoh.graph import Graph
from robomend_client.bridges.zenoh.keys import NODE, TOKENS, BadKey, LivelinessToken, token_key
from robomend_client.bridges.zenoh.session import Link, ZenohSession
from robomend_client.bridges.zenoh.topics import OfferedTopic, ZenohTopic

ALONE_S = 2.0
"""How long nobody may be there before that is said."""


class ZenohNode:
    """One node. Topics are named with their slash, types as std_msgs/String."""

    def __init__(
        self, name: str, domain: int, where: str, problems: Problems, discovery_s: float = 3.0
    ) -> None:
        """`where` others should be, for the log; who is there is found within `discovery_s`."""
        self.name = name
        self.domain = domain
        self._where = where
        self.problems = problems
        self.graph = Graph()
        self.links: list[Link] = []
        self.connected_s: float | None = None  # since when; None: to nobody
        self._alone_s = time.monotonic()  # since when, or when it was last not so
        self._session: ZenohSession | None = None
        self._watched: object = None
        self._topics: dict[str, ZenohTopic] = {}
        self._told: list[OfferedTopic] = []
        self._mismatches: set[str] = set()
        self.unheard = Unheard(discovery_s)

    def subscribe(self, topic: str, on_message: OnMessage) -> None:
        """Listen to a topic, whoever publishes it."""
        if (known := self._topics.get(topic)) is not None:
            known.add(on_message)
        else:
            self._topics[topic] = ZenohTopic(self.domain, topic, on_message, self.problems)

    def publish(self, topic: str, kind: str) -> OfferedTopic:
        """Offer a topic."""
        told = OfferedTopic(self.domain, topic, kind, self.graph)
        self._told.append(told)
        return told

    def read_now(self) -> None:
        """Hand on what has come in; who has come is looked at before: it may be of one who has just begun."""
        if self._session is None:
            return
        self._look(self._session)
        for topic in self._topics.values():
            if topic.take(self.graph):
                self.unheard.heard(topic.topic)

    @property
    def unseen(self) -> set[str]:
        """Topics of which nothing would be heard now if there were something: all, without a connection."""
        self.unheard.look(self._topics)
        return set(self._topics) if self.connected_s is None else set(self.unheard)

    def publishers(self, topic: str) -> tuple[str, ...]:
        """Return the nodes that publish a topic, once for each publisher."""
        return tuple(sorted(token.node for token in self.graph.publishers(topic)))

    def mismatches(self) -> dict[str, str]:
        """Return the topics of which no message goes from a publisher to a subscriber, and why."""
        return self.graph.mismatches()

    async def run(self, session: ZenohSession) -> None:
        """Be a node until cancelled."""
        self.graph.own = session.id
        own = LivelinessToken(self.domain, session.id, NODE, self.name)
        session.token(token_key(own))
        for number, told in enumerate(self._told, 1):
            told.open(session, own, number)
        for topic in self._topics.values():
            topic.follow(session, self.graph)
        self._watched = session.watch(f"{TOKENS}/{self.domain}/**")
        self._session = session
        try:
            await asyncio.Event().wait()  # all else is read
        finally:
            self._session = None
            for told in self._told:
                told.close()
            for topic in self._topics.values():
                topic.close()

    def _look(self, session: ZenohSession) -> None:
        changed = False
        for key, came in session.changes(self._watched):
            changed = True
            try:
                (self.graph.add if came else self.graph.remove)(key)
            except BadKey as error:
                self.problems.tell("a token", str(error))
        self._look_at_links(session.links())
        if changed:
            for topic in self._topics.values():
                topic.follow(session, self.graph)
            self._tell_mismatches()

    def _look_at_links(self, links: list[Link]) -> None:
        self.links = links
        now_s = time.monotonic()
        if links:
            self._alone_s = now_s
            if self.connected_s is None:
                self.connected_s = now_s
                self.unheard.of(self._topics)
                self.problems.over("the network")
            return
        self.connected_s = None
        if now_s - self._alone_s > ALONE_S:  # zenoh itself tries again for ever, and says nothing
            self.problems.tell("the network", f"nobody answers at {self._where}: is zenoh's router up?")

    def _tell_mismatches(self) -> None:
        found = self.graph.mismatches()
        for topic, why in found.items():
            self.problems.tell(f"{topic}, its nodes", why)
        for topic in self._mismatches - found.keys():
            self.problems.over(f"{topic}, its nodes")
        self._mismatches = set(found)
