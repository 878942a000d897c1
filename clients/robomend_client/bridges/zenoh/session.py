"""zenoh through the wheel eclipse-zenoh: the only file that knows it, and it knows no ROS.

What comes in waits in zenoh's own rings, of a fixed size, until it is taken: no thread of ours, no callback.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import zenoh
from zenoh.ext import HistoryConfig, declare_advanced_subscriber

MOST_CHANGES = 65536
"""Tokens that may come and go between two looks; zenoh waits when there are more."""


ROUTERS = "@/*/router"
ROUTERS_S = 0.5
"""Routers that are there answer within milliseconds."""


class NoZenoh(Exception):
    """A session cannot be opened; the message says why."""


@dataclass(frozen=True)
class KeyedSample:
    """A message as it came."""

    key: str
    data: bytes
    attachment: bytes


@dataclass(frozen=True)
class Link:
    """A connection to another session; of TCP, the ports on both sides."""

    session: str
    address: str = ""  # the other side's; nothing: it is none of TCP
    port: int = 0
    own_port: int = 0


class KeyReader:
    """Reads what has a key."""

    def __init__(self, session: zenoh.Session, key: str, depth: int, latched: bool) -> None:
        """`latched`: from publishers that keep what they said, also that."""
        ring: Any = zenoh.handlers.RingChannel(depth)
        others = zenoh.Locality.REMOTE
        self._subscriber: Any
        if latched:
            history = HistoryConfig(detect_late_publishers=True)
            self._subscriber = declare_advanced_subscriber(
                session, key, ring, allowed_origin=others, history=history
            )
        else:
            self._subscriber = session.declare_subscriber(key, ring, allowed_origin=others)

    def take(self) -> Iterator[KeyedSample]:
        """Yield what has come in."""
        while (sample := self._subscriber.try_recv()) is not None:
            if sample.kind == zenoh.SampleKind.PUT:
                attached = sample.attachment
                about = b"" if attached is None else attached.to_bytes()
                yield KeyedSample(str(sample.key_expr), sample.payload.to_bytes(), about)

    def close(self) -> None:
        with suppress(zenoh.ZError):  # the session is closed already
            self._subscriber.undeclare()


class KeyWriter:
    """Writes under one key."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._publisher = session.declare_publisher(key)

    def write(self, data: bytes, attachment: bytes) -> None:
        with suppress(zenoh.ZError):  # nobody is connected any more
            self._publisher.put(data, attachment=attachment)


class ZenohSession:
    """One session with all that it has."""

    def __init__(self, connect: Sequence[str], config: str | None) -> None:
        """
        Args:
            connect: where others are, as zenoh writes it: tcp/localhost:7447.
            config: a file with zenoh's configuration; None: what rmw_zenoh's sessions have.

        Raises:
            NoZenoh: it cannot be opened. That nobody is there yet is no reason.
        """
        try:
            self._session = zenoh.open(configuration(connect, config))
        except zenoh.ZError as error:
            raise NoZenoh(str(error).partition(" at /")[0][:300]) from error
        self.id = str(self._session.info.zid())
        self._tokens: list[Any] = []

    def reader(self, key: str, depth: int, latched: bool) -> KeyReader:
        return KeyReader(self._session, key, depth, latched)

    def writer(self, key: str) -> KeyWriter:
        return KeyWriter(self._session, key)

    def watch(self, key: str) -> Any:
        """Return the tokens that come and go, to be taken by `changes`."""
        waiting: Any = zenoh.handlers.FifoChannel(MOST_CHANGES)
        return self._session.liveliness().declare_subscriber(key, waiting, history=True)

    def changes(self, watched: Any) -> Iterator[tuple[str, bool]]:
        """Yield the tokens that have come (True) or gone."""
        while (sample := watched.try_recv()) is not None:
            yield str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT

    def token(self, key: str) -> None:
        """Say that we are there, until the session ends."""
        self._tokens.append(self._session.liveliness().declare_token(key))

    def links(self) -> list[Link]:
        """Return our connections."""
        return [_link(link) for link in self._session.info.links()]

    def routers(self) -> dict[str, frozenset[str]]:
        """Return the sessions of each router within reach; rmw_zenoh's tell it unless that is forbidden."""
        found = {}
        with suppress(zenoh.ZError):
            for reply in self._session.get(ROUTERS, timeout=ROUTERS_S):
                with suppress(ValueError, KeyError, TypeError):
                    told = json.loads(reply.ok.payload.to_bytes()) if reply.ok is not None else {}
                    found[str(told["zid"])] = frozenset(str(one["peer"]) for one in told["sessions"])
        return found

    def close(self) -> None:
        with suppress(zenoh.ZError):
            self._session.close()  # type: ignore[no-untyped-call]  # the wheel's own omission


def configuration(connect: Sequence[str], config: str | None) -> zenoh.Config:
    """Return the configuration of our session: the user's, or that of rmw_zenoh's own ones.

    Raises:
        ZError: the file, or an address, is none.
    """
    if config is not None:
        found = zenoh.Config.from_file(config)
    else:
        found = zenoh.Config()
        settings: Mapping[str, Any] = {
            "mode": "peer",
            "listen/endpoints": ["tcp/localhost:0"],
            "scouting/multicast/enabled": False,
        }
        for key, value in settings.items():
            found.insert_json5(key, json.dumps(value))
    if connect:
        found.insert_json5("connect/endpoints", json.dumps(list(connect)))
    return found


def _link(link: zenoh.Link) -> Link:
    sides = (str(link.src).partition("/")[::2], str(link.dst).partition("/")[::2])
    kinds, addresses = zip(*sides, strict=True)
    if set(kinds) != {"tcp"}:
        return Link(str(link.zid))
    (_, own_port), (host, port) = (address.partition("?")[0].rsplit(":", 1) for address in addresses)
    return Link(str(link.zid), host.strip("[]"), int(port), int(own_port))
