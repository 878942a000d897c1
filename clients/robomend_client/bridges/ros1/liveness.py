"""Finds out which nodes run: by the connections of /rosout, which every node publishes, and by asking.

    a connection is lost ──► the node is asked at once: gone, or only done with that topic
    nothing heard for `ping_s` ──► it is asked: that finds frozen ones, and those without a connection
    the master's state, each LIST_S ──► nodes that came and went

A node that is asked and says nothing is frozen: at once where its process, on this computer, is halted, and
else after MISSES time-outs, of which those in which we are starved ourselves hardly count. The question stays
open, so that it costs it no second place in its queue, and its answer shows that it is back. But where not
even its computer confirms the question, the network has split: whether the node runs is unknown.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum

from robomend_client.beats import Lateness, beat, done_within
from robomend_client.bridges.processes import Process, has_open, is_ours
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.subscription import Publisher
from robomend_client.bridges.ros1.xmlrpc import (
    Connection,
    Garbage,
    NoAnswer,
    NobodyListens,
    NoConnection,
    OutOfReach,
    PeerError,
    address_of,
    ask,
    connect,
    is_delivered,
)
from robomend_client.python310 import end

# --- which nodes run: a state for each, from what happens. No sockets, no clocks.
#
#     what is seen                                     the node is
#     a connection of its own stands, it answers       running
#     nobody listens at its address any more           gone
#     the connection is taken and nothing said, again  frozen: not running, as far as anybody can use it
#         and again, or its process is halted
#     no way leads to its host, its name is unknown    unknown
#
# The master is believed where it names nodes, and not where it goes on naming them: it does not notice that
# one was killed, and after a restart names none of those that go on.


class NodeState(Enum):
    NEW = "not asked yet"
    RUNNING = "running"
    GONE = "gone"
    FROZEN = "frozen"
    UNREACHABLE = "out of reach"


RUNS: Mapping[NodeState, bool | None] = {
    NodeState.NEW: None,
    NodeState.RUNNING: True,
    NodeState.GONE: False,
    NodeState.FROZEN: False,
    NodeState.UNREACHABLE: None,
}

MOST_NODES = 4096

LAST_WORDS_S = 0.15
"""What is read of a node within so long after it was seen to be gone, it said before."""


@dataclass(slots=True)
class KnownNode:
    """What is known of one node."""

    uri: str = ""  # its address; empty: not asked for yet
    state: NodeState = NodeState.NEW
    links: int = 0  # connections of its own that stand
    heard_s: float = float("-inf")  # when it was last heard: a message, a connection, an answer
    gone_s: float = float("-inf")  # when it was last seen to be gone
    frozen: Mapping[str, str] = field(default_factory=dict)  # why, as the node observer takes it


class Nodes:
    """All nodes of one master, by their full names."""

    def __init__(self) -> None:
        self.known: dict[str, KnownNode] = {}

    def table(self) -> dict[str, bool | None]:
        """Return which run, as observers read it."""
        return {name: RUNS[node.state] for name, node in self.known.items()}

    def why(self, name: str) -> Mapping[str, str] | bool:
        """Return why a node does not run, as the node observer takes it."""
        node = self.known.get(name)
        if node is not None and node.state is NodeState.FROZEN:
            return node.frozen
        if node is not None and node.state is NodeState.GONE:
            return {"why": f"nobody listens at {node.uri or 'its address'} any more", "symptom": "ended"}
        return False

    def listed(self, names: frozenset[str]) -> bool:
        """The master names these; return whether any was forgotten."""
        for name in sorted(names - self.known.keys()):
            if len(self.known) < MOST_NODES:
                self.known[name] = KnownNode()
        ended = [
            name
            for name, node in self.known.items()
            if name not in names and not node.links and node.state is not NodeState.RUNNING
        ]
        for name in ended:
            del self.known[name]
        return bool(ended)

    def linked(self, name: str, uri: str, now_s: float) -> bool:
        """A connection of the node stands; return whether its state is another now."""
        node = self.known.setdefault(name, KnownNode())
        node.uri = uri
        node.links += 1
        return self.asked(name, NodeState.RUNNING, now_s)

    def unlinked(self, name: str) -> None:
        """A connection of the node was lost: that alone says nothing, it may have stopped publishing."""
        if node := self.known.get(name):
            node.links -= 1

    def heard(self, name: str, now_s: float) -> bool:
        """A message of the node was read; return whether its state is another now."""
        node = self.known.get(name)
        if node is None or now_s - node.gone_s < LAST_WORDS_S:
            return False
        node.heard_s = now_s
        return node.state is not NodeState.RUNNING and self._is_now(node, NodeState.RUNNING)

    def asked(self, name: str, state: NodeState, now_s: float) -> bool:
        """The node was asked whether it runs; return whether its state is another now."""
        node = self.known.get(name)
        if node is None:
            return False
        node.heard_s = now_s  # or so: the next question has its time
        node.gone_s = now_s if state is NodeState.GONE else float("-inf")
        return self._is_now(node, state)

    def silent(self, now_s: float, for_s: float) -> frozenset[str]:
        """Return the nodes that have said nothing for so long."""
        return frozenset(name for name, node in self.known.items() if now_s - node.heard_s >= for_s)

    @staticmethod
    def _is_now(node: KnownNode, state: NodeState) -> bool:
        changed = node.state is not state
        node.state = state
        return changed


log = logging.getLogger(__name__)

ROSOUT = "/rosout"
LOOK_S = 0.1
LIST_S = 1.0
TELL_S = 0.3
"""How often the table is told, changed or not; node.py of the observers has it run out after 3 s."""

OPEN_S = 60.0
"""How long a question to a frozen node stays open."""

AGAIN_S = 0.15
"""A node that hung up and still answers may be about to end."""

MISSES, STARVED_MISS = 3, 0.2
"""Time-outs in which a node that works says nothing, and what one counts while we get no processor."""

MOST_AT_ONCE = 16
"""Questions that begin in one beat."""


class Liveness:
    """See the module."""

    def __init__(
        self,
        node: RosNode,
        on_table: Callable[[dict[str, bool | None]], None],
        ping_s: float,
        ping_timeout_s: float,
    ) -> None:
        self.nodes = Nodes()
        self._node = node
        self._on_table = on_table
        self._ping_s = ping_s
        self._timeout_s = ping_timeout_s
        self._questions: dict[str, asyncio.Task[None]] = {}
        self._lateness, self._starved = Lateness(), False
        self._closed = False
        self._complete = False  # the master has named its nodes: until then who is not known is not stopped
        node.subscribe(ROSOUT, self._message, on_link=self._link)

    async def run(self) -> None:
        """Watch until cancelled."""
        tell_at = 0.0
        listing = asyncio.create_task(self._lists(), name="the master's nodes")
        try:
            while not listing.done():
                now_s = time.monotonic()
                silent = self.nodes.silent(now_s, self._ping_s) - self._questions.keys()
                for name in sorted(silent)[:MOST_AT_ONCE]:
                    self._ask(name)
                if now_s >= tell_at:
                    tell_at = now_s + TELL_S
                    self._tell()
                self._starved = self._lateness.look(await beat(LOOK_S))
            listing.result()
        finally:
            self._closed = True
            await end([listing, *self._questions.values()])

    async def _lists(self) -> None:
        """Ask the master for its nodes, now and then: a master that does not answer delays nothing else."""
        while True:
            await self._list()
            await beat(LIST_S)

    # --- what is seen ----------------------------------------------------------------------------------

    def _message(self, publisher: Publisher, _: bytes, __: int) -> None:
        self.heard(publisher)

    def heard(self, publisher: Publisher) -> None:
        """A message of a node came, of any topic."""
        if self.nodes.heard(publisher.node, time.monotonic()):
            self._tell()

    def _link(self, publisher: Publisher, stands: bool) -> None:
        if stands:
            if self.nodes.linked(publisher.node, publisher.uri, time.monotonic()):
                self._tell()
        else:
            self.nodes.unlinked(publisher.node)
            self._ask(publisher.node, again=True)

    async def _list(self) -> None:
        if not self._node.known.is_set():
            return
        try:
            names = (await self._node.master.graph(types=False)).nodes - {self._node.name}
        except (NoAnswer, NobodyListens, OutOfReach):
            return  # the node asks it as often, and tells that
        except PeerError as error:
            self._node.problems.tell("the master", str(error))
            return
        self._complete = True
        if self.nodes.listed(names):
            self._tell()

    # --- asking ----------------------------------------------------------------------------------------

    def _ask(self, name: str, again: bool = False) -> None:
        """Ask a node whether it runs, unless it is being asked; with `again`, twice."""
        if self._closed or name in self._questions or name not in self.nodes.known:
            return
        task = asyncio.create_task(self._question(name, again), name=f"asking {name}")
        self._questions[name] = task
        task.add_done_callback(lambda _: self._questions.pop(name, None))

    async def _question(self, name: str, again: bool) -> None:
        state = await self._state(name)
        if again and state is NodeState.RUNNING:
            self._found(name, state)
            await asyncio.sleep(AGAIN_S)
            state = await self._state(name)
        self._found(name, state)

    def _found(self, name: str, state: NodeState) -> None:
        if self.nodes.asked(name, state, time.monotonic()):
            log.info("ROS 1: the node %s is %s", name, state.value)
            self._tell()

    async def _state(self, name: str) -> NodeState:
        """Ask a node whether it runs."""
        known = self.nodes.known.get(name)
        if known is None:
            return NodeState.GONE
        problems = self._node.problems
        try:
            if not known.uri or known.state is not NodeState.RUNNING:
                with suppress(PeerError):  # of the master: that says nothing of the node
                    # It may have been started anew, elsewhere.
                    known.uri = await self._node.master.lookup_node(name) or known.uri
            if not known.uri:
                return NodeState.NEW
            connection = await connect(*address_of(known.uri), self._timeout_s)
            await self._answer(name, connection)
        except (NobodyListens, Garbage):
            return NodeState.GONE
        except NoAnswer:
            return NodeState.FROZEN
        except NoConnection as error:
            if known.state is NodeState.FROZEN:
                return NodeState.FROZEN  # its queue is full
            problems.tell(name, f"{error}; whether it runs is unknown")
            return NodeState.UNREACHABLE
        except OutOfReach as error:
            problems.tell(name, f"{error}; whether it runs is unknown")
            return NodeState.UNREACHABLE
        except PeerError as error:  # it understood, and refused: it is there
            log.debug("ROS 1: %s: %s", name, error)
        problems.over(name)
        return NodeState.RUNNING

    async def _answer(self, name: str, connection: Connection) -> None:
        """Ask, and wait for the answer; without one for so long the node is frozen from then on.

        Raises:
            OutOfReach: the question did not get to its computer.
            PeerError: what came of it otherwise.
        """
        call = ask(connection, "getPid", self._node.name, timeout_s=OPEN_S)
        question = asyncio.create_task(call, name=f"getPid of {name}")
        missed, began_s = 0.0, time.monotonic()
        process: Process | None = None
        try:
            while not await done_within(question, self._timeout_s):
                if not is_delivered(connection):
                    raise OutOfReach("its computer does not confirm what is sent to it")
                missed += STARVED_MISS if self._starved else 1
                process = process or await asyncio.to_thread(_process, connection)
                if process is not None and not process.works():
                    self._freeze(name, process.why())
                elif missed >= MISSES:
                    for_s = time.monotonic() - began_s
                    self._freeze(name, {"why": f"does not answer for {for_s:.3g} s", "symptom": "halted"})
                else:
                    continue
                break
            await question
        finally:
            await end([question])

    def _freeze(self, name: str, why: Mapping[str, str]) -> None:
        if node := self.nodes.known.get(name):
            node.frozen = why
        self._found(name, NodeState.FROZEN)

    def _tell(self) -> None:
        if self._complete:
            self._on_table(self.nodes.table())


def _process(connection: Connection) -> Process | None:
    """Return the process at the other end, where that is this computer and we may see it."""
    address, port = connection[1].get_extra_info("peername")[:2]
    return has_open(lambda local, _: local == port, ("tcp", "tcp6")) if is_ours(address) else None
