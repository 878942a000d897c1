"""The bridge as a ROS node: its registrations at the master, and the calls that it answers.

    once a second: does the master know us?  no ──► register everything anew (it has been restarted)
    publisherUpdate from the master ──► subscription

Another node that registers with our name takes it: the master tells us to shut down. We are silent then,
until the name is free again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import time
from collections.abc import Callable
from typing import Any

from robomend_client.beats import beat
from robomend_client.bridges.problems import Complaint, Problems
from robomend_client.bridges.ros1.master import Master
from robomend_client.bridges.ros1.publication import Describe, Publication, Subscriber
from robomend_client.bridges.ros1.subscription import Bursts, OnLink, OnMessage, Subscription
from robomend_client.bridges.ros1.xmlrpc import PeerError, XmlRpcServer, address_of
from robomend_client.python310 import timeout

log = logging.getLogger(__name__)

LOOK_S = 1.0
"""How often the master is asked whether it still knows us."""

GOODBYE_S = 2.0


class RosNode:
    """One ROS node. Topics are named with their slash."""

    def __init__(
        self,
        name: str,
        master_uri: str,
        address: str | None,
        problems: Problems,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """
        Args:
            address: the host name or number under which others reach us; None: the one that faces the master.
            now_ns: the clock by which it is told when messages came.
        """
        self.name = name
        self.problems = problems
        self.master = Master(master_uri, name)
        self.known = asyncio.Event()  # the master knows us
        self.api = ""
        self._address = address
        self._server = XmlRpcServer(self._answer, self._garbage)
        self._messages: asyncio.Server | None = None
        self._bursts = Bursts(now_ns)
        self._subscriptions: dict[str, Subscription] = {}
        self._publications: dict[str, Publication] = {}
        self._displaced = False

    def subscribe(
        self,
        topic: str,
        on_message: OnMessage,
        keep: bool = False,
        on_link: OnLink | None = None,
        up_to: int = 0,
    ) -> Subscription:
        """Listen to a topic, from the next registration on; of several who do, each gets its messages."""
        if (known := self._subscriptions.get(topic)) is not None:
            known.add(on_message, keep, on_link)
            return known
        found = Subscription(topic, self.name, on_message, self.problems, self._bursts, keep, on_link, up_to)
        self._subscriptions[topic] = found
        return found

    async def listen(self, topic: str, on_message: OnMessage, keep: bool = False) -> None:
        """Listen to one more topic while the node runs.

        Raises:
            PeerError: the master does not take it; it is tried again with the next registration.
        """
        found = self.subscribe(topic, on_message, keep)
        if self.known.is_set():
            found.publishers(self._others(await self._register(found)))

    def publish(self, topic: str, type_name: str, describe: Describe, latched: bool = False) -> Publication:
        """Offer a topic, from the next registration on."""
        known = self._publications.get(topic)
        if known is not None and known.type_name == type_name:
            return known
        found = Publication(topic, self.name, type_name, describe, latched)
        self._publications[topic] = found
        return found

    def read_now(self) -> None:
        """Take in what has come on all topics by now: nobody else does, but for what is read as it comes."""
        self._bursts.read()

    @property
    def unseen(self) -> set[str]:
        """Topics of which nothing would be heard if there were something: no publisher is connected, and who
        publishes is not known.
        """
        return {topic for topic in self.connecting if not self._subscriptions[topic].nodes}

    @property
    def connecting(self) -> set[str]:
        """Topics of which a publisher may be there that is not connected yet."""
        known = self.known.is_set()
        return {topic for topic, one in self._subscriptions.items() if one.open or not known}

    def publishers(self, topic: str) -> tuple[str, ...]:
        """Return the nodes that publish a topic, as far as they are connected."""
        one = self._subscriptions.get(topic)
        return () if one is None else tuple(sorted(one.nodes))

    async def run(self) -> None:
        """Be a node until cancelled."""
        try:
            await self._open()
            while True:
                try:
                    await self._look()
                    self.problems.over("the master")
                except PeerError as error:
                    self.known.clear()
                    self.problems.tell("the master", f"{error} ({self.master.uri})")
                await beat(LOOK_S)
        finally:
            await self._close()

    # --- the master ------------------------------------------------------------------------------------

    async def _look(self) -> None:
        """Register everything, unless the master knows us."""
        found = await self.master.lookup_node(self.name)
        if found == self.api and self.known.is_set():
            return
        if found is not None and found != self.api and self._displaced:
            self.problems.tell(
                self.name, f"another node has taken this name ({found}); set `name:` in the section ros1"
            )
            return
        if self.known.is_set():
            log.warning("ROS 1: the master does not know us any more: everything is registered anew")
        self._displaced = False
        self.known.clear()
        for publication in self._publications.values():
            await self.master.register_publisher(publication.topic, publication.type_name, self.api)
        told: set[str] = set()
        while new := [one for topic, one in self._subscriptions.items() if topic not in told]:
            for subscription in new:  # more of them may come meanwhile
                subscription.publishers(self._others(await self._register(subscription)))
                told.add(subscription.topic)
        self.known.set()
        self.problems.over(self.name)
        log.info("ROS 1: %s is known to the master at %s", self.name, self.master.uri)

    async def _register(self, subscription: Subscription) -> list[str]:
        return await self.master.register_subscriber(subscription.topic, self.api)

    def _others(self, uris: list[str]) -> list[str]:
        """Our own echoes are nothing to listen to."""
        return [uri for uri in uris if uri != self.api]

    # --- what others ask -------------------------------------------------------------------------------

    def _answer(self, method: str, arguments: tuple[Any, ...]) -> Any:
        """Answer a call of the slave API."""
        match method, arguments:
            case "publisherUpdate", (_, str(topic), [*uris]):
                subscription = self._subscriptions.get(topic)
                if subscription is not None:
                    subscription.publishers(self._others([str(uri) for uri in uris]))
                return [1, "", 0]
            case "requestTopic", (_, str(topic), [*protocols]):
                if topic not in self._publications:
                    return [0, f"{self.name} does not publish {topic}", []]
                if not any(isinstance(p, list) and p[:1] == ["TCPROS"] for p in protocols):
                    return [0, "only TCPROS is spoken here", []]
                assert self._messages is not None
                port = self._messages.sockets[0].getsockname()[1]
                return [1, "", ["TCPROS", address_of(self.api)[0], port]]
            case "getPid", _:
                return [1, "", os.getpid()]
            case "getMasterUri", _:
                return [1, "", self.master.uri]
            case "getSubscriptions", _:
                return [1, "", [[s.topic, s.type or "*"] for s in self._subscriptions.values()]]
            case "getPublications", _:
                return [1, "", [[p.topic, p.type_name] for p in self._publications.values()]]
            case "getBusInfo", _:
                return [1, "", []]
            case "getBusStats", _:
                return [1, "", [[], [], []]]
            case "paramUpdate", _:
                return [1, "", 0]
            case "shutdown", _:
                # Anybody may ask for that (rosnode kill): believed is what the master then says of our name.
                self._displaced = True
                self.known.clear()
                return [1, "", 0]
        return [-1, f"{method} is not known here", 0]

    def _garbage(self, computer: str, why: str) -> None:
        self.problems.tell(f"a caller at {computer}", Complaint("it speaks no XML-RPC", why[:200]))

    # --- open and close --------------------------------------------------------------------------------

    async def _open(self) -> None:
        address = self._address or await self._facing()
        listen = "127.0.0.1" if address in ("localhost", "127.0.0.1") else "0.0.0.0"
        await self._server.open(listen)
        self.api = f"http://{address}:{self._server.port}/"
        loop = asyncio.get_running_loop()
        self._messages = await loop.create_server(self._subscriber, listen, 0)

    async def _facing(self) -> str:
        """Return our address on the way to the master."""
        host, port = address_of(self.master.uri)
        loop = asyncio.get_running_loop()
        while True:
            try:
                found = await loop.getaddrinfo(host, port, family=socket.AF_INET, type=socket.SOCK_DGRAM)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.connect(found[0][4])  # sends nothing
                    return str(probe.getsockname()[0])
            except OSError as error:
                self.problems.tell("the master", f"{self.master.uri}: {error.strerror or error}")
                await asyncio.sleep(LOOK_S)

    def _subscriber(self) -> Subscriber:
        return Subscriber(self._publications, self.problems)

    async def _close(self) -> None:
        if self.known.is_set():
            with contextlib.suppress(PeerError, TimeoutError):
                async with timeout(GOODBYE_S):
                    for topic in self._publications:
                        await self.master.unregister(topic, self.api, publisher=True)
                    for topic in self._subscriptions:
                        await self.master.unregister(topic, self.api, publisher=False)
        await asyncio.gather(*(subscription.close() for subscription in self._subscriptions.values()))
        self._bursts.close()
        for publication in self._publications.values():
            publication.close()
        if self._messages is not None:
            self._messages.close()
        await self._server.close()
