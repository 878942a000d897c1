"""The bridge as a node of ROS 2 over zenoh: what it listens to, what it tells, and its place in the graph.

`read_now`   who has come and gone? what has come in? ──► whoever wants the topic
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from typing import TypeVar

from robomend_client.bridges.problems import Complaint, Problems
from robomend_client.bridges.processes import Process, has_open, is_ours
from robomend_client.bridges.ros2.base import LOOK_S, Message, OnMessage, Unheard
from robomend_client.bridges.ros2.formats import DIAGNOSTICS, STRING
from robomend_client.bridges.ros2.names import ros_type, wire_type
from robomend_client.bridges.zenoh.keys import (
    NODE,
    PUBLISHER,
    TOKENS,
    Attachment,
    BadKey,
    Graph,
    LivelinessToken,
    attach,
    gid,
    message_key,
    read_attachment,
    token_key,
    type_of,
)
from robomend_client.bridges.zenoh.session import KeyReader, KeyWriter, Link, ZenohSession

# --- a topic that comes in, and one that goes out ----------------------------------------------------------

DEPTH = 100
"""Messages of one topic that may come between two looks: 1 kHz, and twice that."""

HASHES = {
    STRING: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    DIAGNOSTICS: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
"""Of the types that we publish: their definitions have not changed since there are hashes."""


class ZenohTopic:
    """One topic, of whatever type: it is in the message's key."""

    def __init__(self, domain: int, topic: str, on_message: OnMessage, problems: Problems) -> None:
        self.topic = topic
        self._key = message_key(domain, topic, "*", "*")
        self._on_message = [on_message]
        self._problems = problems
        self._reader: KeyReader | None = None
        self._latched = False
        self._type = ""

    def add(self, on_message: OnMessage) -> None:
        """Somebody else wants the topic, too."""
        self._on_message.append(on_message)

    def follow(self, session: ZenohSession, graph: Graph) -> None:
        """Listen as its publishers speak now: from the start, where all of them are latched."""
        publishers = graph.publishers(self.topic)
        latched = bool(publishers) and all(publisher.latched for publisher in publishers)
        if self._reader is None or latched != self._latched:
            self.close()
            self._latched = latched
            self._reader = session.reader(self._key, DEPTH, latched)
        if publishers and publishers[-1].type != self._type:
            kind, before = ros_type(publishers[-1].type), ros_type(self._type)
            if self._type:
                what = f"{publishers[-1].node} publishes {kind}"
                self._problems.tell(self.topic, f"{what}, where {before} came before")
            self._type = publishers[-1].type

    def take(self, graph: Graph) -> bool:
        """Hand on what has come in; return whether anything had."""
        if self._reader is None:
            return False
        came = False
        for sample in self._reader.take():
            kind, type_hash = type_of(sample.key)
            about = read_attachment(sample.attachment)
            writer = about.gid if about is not None else b""
            node = graph.publisher(writer, self.topic, kind)
            stamp_ns = None if about is None else about.stamp_ns
            if about is None and sample.attachment:
                place = f"what {node} attaches to messages of {self.topic}"
                size = f"{len(sample.attachment)} bytes"
                self._problems.tell(place, Complaint("not understood, timed by its arrival", size))
            message = Message(sample.data, kind, type_hash, writer or node, node, stamp_ns, self._latched)
            came = True
            for on_message in self._on_message:
                on_message(message)
        return came

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


class OfferedTopic:
    """A topic that we publish, under the key of each hash that somebody listens for.

    Robots up to Humble know no hashes; their subscribers have a key of their own.
    """

    def __init__(self, domain: int, topic: str, kind: str, graph: Graph) -> None:
        self.topic = topic
        self._domain = domain
        self._kind = wire_type(kind)
        self._hashes = (HASHES[kind], "")
        self._graph = graph
        self._session: ZenohSession | None = None
        self._writers: dict[str, KeyWriter] = {}
        self._gid = b""
        self._number = 0

    def open(self, session: ZenohSession, node: LivelinessToken, entity_id: int) -> None:
        """Say that we publish it."""
        topic = (self.topic, self._kind, self._hashes[0])
        whole = LivelinessToken(
            node.domain, node.session, PUBLISHER, node.node, *topic, entity_id=str(entity_id)
        )
        key = token_key(whole)
        session.token(key)
        self._gid = gid(key)
        self._session = session

    @property
    def wanted(self) -> bool:
        """Whether anybody else listens."""
        return bool(self._listened())

    def publish(self, message: bytes) -> None:
        if self._session is None:
            return
        self._number += 1
        about = attach(Attachment(self._number, time.time_ns(), self._gid))
        for type_hash in self._listened():
            if type_hash not in self._writers:
                key = message_key(self._domain, self.topic, self._kind, type_hash)
                self._writers[type_hash] = self._session.writer(key)
            self._writers[type_hash].write(message, about)

    def close(self) -> None:
        self._session = None
        self._writers.clear()

    def _listened(self) -> set[str]:
        listeners = self._graph.subscribers(self.topic)
        return {
            listener.type_hash
            for listener in listeners
            if listener.type == self._kind and listener.type_hash in self._hashes
        }


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
            if self._session is not None:
                self._topics[topic].follow(self._session, self.graph)

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


# --- which nodes run: by their tokens, and for those on this computer by their processes.
#
# what is seen                                         the node is
# its token is there                                   running
# its token has gone: it was destroyed, it said        not running, at once
#     goodbye, its connection is closed or its lease
#     is over (10 s or more)
# its process on this computer is stopped              not running, at once
# its token has gone with the router that it was       unknown: the network may have split
#     behind, and that does not answer any more
# we have no connection to anybody, or only just now   unknown: the tokens went with the network

ASK_S = 5.0
"""How often routers are asked who is behind them."""

MOST_SESSIONS = 65536
Known = TypeVar("Known")


class Liveness:
    """Of all nodes of one domain."""

    def __init__(self, node: ZenohNode, session: ZenohSession, settled_s: float) -> None:
        """`settled_s` after a connection was made, all tokens have come."""
        self._node = node
        self._session = session
        self._behind: dict[str, str] = {}  # session -> the router that it is connected to
        self._routers: frozenset[str] = frozenset()  # that answer
        self._asked_s = float("-inf")
        self._near: dict[str, bool] = {}  # sessions of this computer: no network splits them off
        self._silent: set[str] = set()  # routers that were told of
        self._back: set[str] = set()  # those of them that answer again
        self._settled_s = settled_s
        self._processes: dict[Link, Process | None] = {}
        self._before: dict[str, bool] = {}

    async def look(self) -> dict[str, bool | None] | None:
        """Return which nodes run now, None where that is unknown; None: nobody knows."""
        found = await self._look()
        if found is not None and any(self._before.get(node) and not runs for node, runs in found.items()):
            await asyncio.sleep(LOOK_S)  # a connection that ends takes the tokens along, a little before it
            found = await self._look()
        ended = found is not None and any(self._before.get(node) and not runs for node, runs in found.items())
        self._before = found or {}
        if found is None:
            return None
        if ended or time.monotonic() - self._asked_s >= ASK_S:
            await self._ask_routers()
        return self._without_routers(found)

    async def _ask_routers(self) -> None:
        told = await asyncio.to_thread(self._session.routers)
        self._asked_s = time.monotonic()
        # one that is back is believed when asked again: what is behind it comes a little later
        self._routers = frozenset(told.keys() - (self._silent - self._back))
        self._back = told.keys() & self._silent
        if len(self._behind) > MOST_SESSIONS:
            self._behind.clear()
        self._behind |= {session: router for router, sessions in told.items() for session in sessions}

    def _without_routers(self, found: dict[str, bool]) -> dict[str, bool | None]:
        """Return which nodes run, where those that went with their router are unknown."""
        table: dict[str, bool | None] = dict(found)
        silent = set()
        for node, runs in found.items():
            session = self._node.graph.session_of(node)
            if not runs and not any(_of(self._near, session)):
                for router in _of(self._behind, session):
                    if router not in self._routers:
                        table[node] = None
                        silent.add(router)
        for router in silent - self._silent:
            why = "it does not answer any more: whether the nodes behind it run is unknown"
            self._node.problems.tell(f"the router {router}", why)
        for router in self._silent - silent:
            self._node.problems.over(f"the router {router}")
        self._silent = silent
        return table

    async def _look(self) -> dict[str, bool] | None:
        since_s = self._node.connected_s
        if since_s is None or time.monotonic() - since_s < self._settled_s:
            return None
        links = set(self._node.links)
        for link in self._processes.keys() - links:
            del self._processes[link]
        for link in links - self._processes.keys():
            process = self._processes[link] = await asyncio.to_thread(_process, link)
            if process is not None and len(self._near) < MOST_SESSIONS:
                self._near[link.session] = True
        works = {link.session: p.works() for link, p in self._processes.items() if p is not None}
        sessions = self._node.graph.sessions()
        return self._node.graph.nodes({s for s in sessions if not all(_of(works, s))})


def _process(link: Link) -> Process | None:
    """Return the process at the other end, where that is on this computer."""
    if not link.port or not is_ours(link.address):
        return None
    return has_open(lambda local, remote: (local, remote) == (link.port, link.own_port), ("tcp", "tcp6"))


def _of(works: Mapping[str, Known], session: str) -> Iterable[Known]:
    """Return what is known of a session, by its name in tokens: releases of 2024 leave out zeros."""
    for linked, runs in works.items():
        padded = linked.zfill(len(linked) + len(linked) % 2)
        short = "".join(f"{int(padded[n : n + 2], 16):x}" for n in range(0, len(padded), 2))
        if session in (linked, padded, short):
            yield runs
