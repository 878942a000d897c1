"""Services that are watched: each is asked, now and then, who it is. It is not called.

the master names nobody, nobody listens there      it is not there
a connection is taken and nothing said             it is frozen
no way leads there                                 nothing is known, and nothing said
it answers with its header                         it is there
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from robomend_client.beats import beat, done_within
from robomend_client.bridges.problems import Complaint
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.tcpros import (
    LENGTH,
    LONGEST_HEADER,
    ProtocolError,
    decode_header,
    encode_header,
)
from robomend_client.bridges.ros1.xmlrpc import (
    NobodyListens,
    OutOfReach,
    PeerError,
    address_of,
    connect,
)
from robomend_client.python310 import end

LOOK_S = 1.0
"""How often each is asked; a header from a computer in the same room takes some milliseconds."""

OnState = Callable[[str, bool], None]


class Services:
    """Watches some services of a master."""

    def __init__(
        self, node: RosNode, services: Mapping[str, str], on_state: OnState, timeout_s: float
    ) -> None:
        """
        Args:
            services: source -> the service's full name.
            on_state: called with the source, and whether the service answers.
            timeout_s: one that says nothing for so long is frozen.
        """
        self._node = node
        self._services = dict(services)
        self._on_state = on_state
        self._timeout_s = timeout_s

    async def run(self) -> None:
        """Watch until cancelled."""
        tasks = [asyncio.create_task(self._watch(*service)) for service in self._services.items()]
        try:
            await asyncio.gather(*tasks)
        finally:
            await end(tasks)

    async def _watch(self, source: str, service: str) -> None:
        while True:
            if self._node.known.is_set():
                answers = await self._answers(service)
                if answers is not None:
                    self._on_state(source, answers)
            await beat(LOOK_S)

    async def _answers(self, service: str) -> bool | None:
        """Ask a service who it is; None: whether it is there cannot be seen."""
        place = f"the service {service}"
        try:
            uri = await self._node.master.lookup_service(service)
        except PeerError:
            return None  # of the master: the node tells that
        if uri is None:
            return False
        try:
            await self._header(*address_of(uri), service)
        except NobodyListens:
            return False
        except OutOfReach as error:
            self._node.problems.tell(place, f"{error}; whether it is there is unknown")
            return None
        except (OSError, EOFError, ProtocolError) as error:
            self._node.problems.tell(place, _unsaid(error))
            return False
        self._node.problems.over(place)
        return True

    async def _header(self, host: str, port: int, service: str) -> None:
        """Say that we only look; take its header.

        Raises:
            PeerError: nobody is there, or no way leads there.
            OSError, EOFError, ProtocolError: it does not answer as a service.
        """
        reader, writer = await connect(host, port, self._timeout_s)
        hello = {"callerid": self._node.name, "service": service, "md5sum": "*", "probe": "1"}
        answer = asyncio.create_task(read_header(reader))
        try:
            writer.write(encode_header(hello))
            if not await done_within(answer, self._timeout_s):
                raise OSError(f"nothing within {self._timeout_s:g} s")
            header = answer.result()
        finally:
            writer.close()
            await end([answer])
        if "error" in header:
            raise ProtocolError(header["error"][:200])


async def read_header(reader: asyncio.StreamReader) -> dict[str, str]:
    """Return the fields of a header that comes now.

    Raises:
        OSError, EOFError, ProtocolError: none comes.
    """
    (length,) = LENGTH.unpack(await reader.readexactly(LENGTH.size))
    if length > LONGEST_HEADER:
        raise ProtocolError("a header that is too long", f"{length} bytes")
    return decode_header(await reader.readexactly(length))


def _unsaid(error: Exception) -> Complaint:
    """Return what is wrong with a service that does not say who it is."""
    kind, seen = (error.kind, error.seen) if isinstance(error, Complaint) else (str(error), "")
    return Complaint(f"it does not say who it is: {kind}"[:200], seen)
