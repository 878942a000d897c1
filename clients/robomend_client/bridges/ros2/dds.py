"""DDS through the cyclonedds wheel: the only file that knows it, and it knows no messages, only their bytes.

The bridge writes its own configuration, after the user's CYCLONEDDS_URI: without it types in types of current
Fast DDS never match (Cyclone DDS cannot read their type objects, and says so on standard error only).

A topic of any type is read as bytes: the reader has the type's name, and a class that keeps what came in.
"""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from types import new_class
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import DDSException, InstanceState, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from robomend_client.bridges.ros2.discovered import Discovered, Endpoint, Participant

VENDORS = "1.15,1.16"
"""eProsima and Cyclone DDS: the type information that theirs send along is not looked at."""

LOOPBACK = '<NetworkInterface name="lo" multicast="true"/>'
ASKED = (
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>119</MaxAutoParticipantIndex>"
    "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
)
"""Peers are asked for ever, at each port that a participant may have: those that begin later may know no way
to us, and we ourselves need one that is free."""

ASKED_EACH = "1s", "5s"
"""On this computer only, and over a network, which is to have other things to carry."""

OWN_DOMAINS = 1000
"""Numbers from here on are this process's own; on the network such a domain has another number."""

MOST_AT_ONCE = 100
FOREVER_NS = 2**63 - 1

OURS = Policy.IgnoreLocal.Participant  # no echo
ROS_BYTES = Policy.DataRepresentation(use_cdrv0_representation=True)
RELIABLE = Policy.Reliability.Reliable(duration(milliseconds=100))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1), ROS_BYTES, OURS)
SENT = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10), ROS_BYTES, OURS)

DURABILITIES = (
    Policy.Durability.Volatile,
    Policy.Durability.TransientLocal,
    Policy.Durability.Transient,
    Policy.Durability.Persistent,
)


class NoDds(Exception):
    """DDS cannot be opened; the message says why."""


class Sample(NamedTuple):
    """A message as it came: its bytes, its writer, and the writer's stamp."""

    data: bytes
    writer: int
    time_ns: int


@lru_cache(maxsize=1024)
def _unread(kind: str) -> Any:
    """Return the class of a type of which only the name is known: its messages are not looked into."""

    def serialize(self: Any, *_: Any, **__: Any) -> bytes:
        data: bytes = self.data
        return data

    def deserialize(cls: Any, data: bytes, *_: Any, **__: Any) -> Any:
        found = cls(0)
        found.data = data
        return found

    body = {
        "__annotations__": {"never": uint8},  # one member there must be
        "__module__": __name__,
        "serialize": serialize,
        "deserialize": classmethod(deserialize),
    }
    given = {"typename": kind.replace("::", ".")}
    made: Any = new_class("UnreadMessage", (IdlStruct,), given, lambda namespace: namespace.update(body))
    return final(dataclass(made))


M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_FREE = 16 * 1024 * 1024


def keep_freed_memory() -> None:
    """Have the C library keep some freed memory at hand.

    Each large message is memory that is asked for, and freed at the next look. Given back to the kernel in
    between, all its pages are mapped anew, which costs more than all else that is done with an image that is
    only counted. Where the C library is not glibc nothing happens.
    """
    with suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_TRIM_THRESHOLD, KEPT_FREE)
        mallopt(M_MMAP_THRESHOLD, KEPT_FREE)


class RawReader:
    """Reads one topic."""

    def __init__(
        self, participant: DomainParticipant, topic: str, kind: str, depth: int, latched: bool
    ) -> None:
        keep = Policy.History.KeepLast(depth)
        lossy = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, keep, ROS_BYTES, OURS)
        qos = Qos(keep, base=LATCHED) if latched else lossy
        self._depth = depth
        self._topic: Any = Topic(participant, topic, _unread(kind))
        self._reader: Any = DataReader(participant, self._topic, qos=qos)

    @property
    def key(self) -> bytes:
        return bytes(self._reader.guid.bytes)

    def take(self) -> list[Sample]:
        """Return what has come in."""
        return [
            Sample(found.data, found.sample_info.publication_handle, found.sample_info.source_timestamp)
            for found in self._reader.take(self._depth)
            if found.sample_info.valid_data
        ]

    def close(self) -> None:
        _delete((self._reader, self._topic))


class RawWriter:
    """Writes one topic."""

    def __init__(self, participant: DomainParticipant, topic: str, kind: str, latched: bool) -> None:
        self._type = _unread(kind)
        self._topic: Any = Topic(participant, topic, self._type)
        self._writer: Any = DataWriter(participant, self._topic, qos=LATCHED if latched else SENT)

    @property
    def key(self) -> bytes:
        return bytes(self._writer.guid.bytes)

    def write(self, data: bytes) -> None:
        self._writer.write(self._type.deserialize(data))

    def close(self) -> None:
        _delete((self._writer, self._topic))


class Dds:
    """Our participant in a domain, and what it has."""

    def __init__(self, domain: int, config: str, number: int | None = None) -> None:
        """
        Args:
            number: this process's own for the domain; None: the domain's.

        Raises:
            NoDds: the domain cannot be entered.
        """
        keep_freed_memory()
        self._open: list[Any] = []
        self._entered = (domain, config)
        self._number = domain if number is None else number
        if number is not None:
            known = f"<Discovery><ExternalDomainId>{domain}</ExternalDomainId></Discovery>"
            config += f',<CycloneDDS><Domain id="any">{known}</Domain></CycloneDDS>'
        try:
            self._open.append(Domain(self._number, config))
            self._participant = DomainParticipant(self._number, qos=Qos(Policy.Userdata(b"enclave=/;")))
            self._open.append(self._participant)
            self._participants, self._writers, self._readers = (
                BuiltinDataReader(self._participant, topic)
                for topic in (
                    BuiltinTopicDcpsParticipant,
                    BuiltinTopicDcpsPublication,
                    BuiltinTopicDcpsSubscription,
                )
            )
        except DDSException as error:
            self.close()
            raise NoDds(f"domain {domain} cannot be entered: {error.msg}") from error
        self.key = bytes(self._participant.guid.bytes)

    def reader(self, topic: str, kind: str, depth: int = 1, latched: bool = False) -> RawReader:
        """Listen to a topic, by the names on the wire; `latched`: from reliable writers, also what was said.

        Raises:
            NoDds: these names are none.
        """
        try:
            return RawReader(self._participant, topic, kind, depth, latched)
        except (DDSException, ValueError, TypeError) as error:
            raise NoDds(f"{kind} cannot be listened to: {error}") from error

    def writer(self, topic: str, kind: str, latched: bool = False) -> RawWriter:
        """Offer a topic; `latched`: who comes later is told the last message."""
        return RawWriter(self._participant, topic, kind, latched)

    def discover(self, found: Discovered) -> bool:
        """Tell what is new on the network; return whether anything was."""
        changed = False
        for sample in _all(self._participants):
            changed = True
            if sample.sample_info.instance_state == InstanceState.Alive:
                found.participant(_participant(sample))
            else:
                found.participant_gone(sample.key.bytes)
        for reader, writes in ((self._writers, True), (self._readers, False)):
            for sample in _all(reader):
                changed = True
                if sample.sample_info.instance_state == InstanceState.Alive:
                    found.endpoint(_endpoint(sample, writes))
                else:
                    found.endpoint_gone(sample.key.bytes)
        return changed

    def close(self) -> None:
        """Leave the domain; readers and writers are closed before."""
        _delete(reversed(self._open))
        self._open.clear()

    def again(self) -> Dds:
        """Enter the domain once more, as somebody else: who is there tells us everything.

        Participants of one Domain are told everything together; and of one number a process has one Domain.

        Raises:
            NoDds: it cannot be entered.
        """
        number = OWN_DOMAINS + 1 if self._number == OWN_DOMAINS else OWN_DOMAINS
        return Dds(*self._entered, number)


def _all(reader: Any) -> Iterator[Any]:
    while samples := reader.take(MOST_AT_ONCE):
        yield from samples


def _participant(sample: Any) -> Participant:
    said = {p.key: p.value for p in sample.qos if isinstance(p, Policy.Property)}
    about = sample.qos[Policy.Userdata].data if Policy.Userdata in sample.qos else b""
    # udp/192.0.2.2:7411@4, perhaps several
    address, _, port = said.get("__NetworkAddresses", "").split(",")[0].partition("@")[0].rpartition(":")
    pid = said.get("__Pid") or said.get("fastdds.physical_data.process") or "0"
    return Participant(
        sample.key.bytes,
        address.rpartition("/")[2],
        int(port) if port.isdecimal() else 0,
        int(pid) if pid.isdecimal() else 0,
        about.startswith(b"enclave="),
    )


def _endpoint(sample: Any, writes: bool) -> Endpoint:
    qos = sample.qos
    deadline = qos[Policy.Deadline]
    said = (qos[Policy.Userdata].data if Policy.Userdata in qos else b"").decode(errors="replace")
    hashes = [part.partition("=")[2] for part in said.split(";") if part.startswith("typehash=")]
    return Endpoint(
        sample.key.bytes,
        sample.participant_key.bytes,
        sample.topic_name,
        sample.type_name,
        writes,
        qos[Policy.Reliability] != Policy.Reliability.BestEffort,
        DURABILITIES.index(qos[Policy.Durability] or Policy.Durability.Volatile),
        None if deadline is None or deadline.deadline == FOREVER_NS else deadline.deadline,
        sample.sample_info.instance_handle,
        hashes[0] if hashes else "",
    )


def _delete(entities: Iterable[Any]) -> None:
    for entity in entities:
        entity.__del__()  # cyclonedds has no other name for it; a second time does nothing


def configuration(environment: Mapping[str, str], localhost: bool, peers: Collection[str]) -> str:
    """Return the configuration of our participant: the user's, and after it what ROS and Fast DDS need.

    Args:
        localhost: only this computer is looked at.
        peers: computers that are asked beside those that multicast finds.
    """
    addresses = [*(["127.0.0.1"] if localhost else []), *peers]
    listed = "".join(f"<Peer address={quoteattr(address)}/>" for address in addresses)
    general = f"<General><Interfaces>{LOOPBACK}</Interfaces></General>" if localhost else ""
    each = f"<SPDPInterval>{ASKED_EACH[bool(peers)]}</SPDPInterval>"
    discovery = f"<Discovery>{ASKED}{each}<Peers>{listed}</Peers></Discovery>" if listed else ""
    types = f"<Compatibility><IgnoreTypeInformation>{VENDORS}</IgnoreTypeInformation></Compatibility>"
    ours = f'<CycloneDDS><Domain id="any">{general}{discovery}{types}</Domain></CycloneDDS>'
    return ",".join(filter(None, (environment.get("CYCLONEDDS_URI", ""), ours)))


def only_here(environment: Mapping[str, str]) -> bool:
    """Return whether the environment says that ROS looks at this computer only."""
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return reach == "LOCALHOST" or (not reach and environment.get("ROS_LOCALHOST_ONLY") == "1")
