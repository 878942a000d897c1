"""The bridge as a feed: the section `ros2:` of the agent's file."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from robomend_client.agent.feeds import Deliver
from robomend_client.bridges.base import Runs
from robomend_client.bridges.ros2.base import Message, OnMessage, Ros2Bridge, Unheard
from robomend_client.bridges.ros2.dds import Dds, NoDds, Sample, configuration, only_here
from robomend_client.bridges.ros2.discovered import Endpoint, Participant
from robomend_client.bridges.ros2.liveness import Liveness
from robomend_client.bridges.ros2.node import DdsNode, Forgotten, ToldByUs
from robomend_client.yaml_reader import Section

AGAIN_S = 3.0


class Ros2(Ros2Bridge):
    """The feed `ros2`: ROS 2 over DDS."""

    folder = "ros2-observations"

    def __init__(self, section: Section, base: Path, sources: frozenset[str]) -> None:
        super().__init__(section, base, sources, "ROS 2")
        section.explain(
            discovery="how far it looks for others: `subnet`, or `localhost` (the default where "
            "ROS_AUTOMATIC_DISCOVERY_RANGE or ROS_LOCALHOST_ONLY says so)",
            peers="computers that are asked beside those that multicast finds",
        )
        ranges = ("subnet", "localhost")
        self.localhost = section.choice("discovery", ranges, ranges[only_here(os.environ)]) == "localhost"
        self.peers = section.texts("peers")

    @property
    def environment(self) -> dict[str, str]:
        here = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        peers = {"ROS_STATIC_PEERS": ";".join(self.peers)} if self.peers else {}
        return {**super().environment, **(here if self.localhost else {}), **peers}

    async def run(self, deliver: Deliver) -> None:
        """Be a node of the domain, and deliver what it hears, until cancelled."""
        await self.import_reader()
        lost: Mapping[Participant, tuple[str, ...]] = {}
        while True:
            dds = await self._open()
            node = DdsNode(self.node_name, self.problems, self.discovery_s)
            node.found.lost.update(lost)
            liveness = Liveness(node.found, self.problems, node.unheard)
            try:
                look = partial(_with_reasons, liveness)
                untold = partial(getattr, node.found, "untold")
                await self.be(_Named(node), node.run(dds), look, untold, deliver)
            except Forgotten:
                self.problems.tell("DDS", "nor do they tell it somebody else: it is left, and entered anew")
                lost = node.found.lost
            finally:
                liveness.close()
                dds.close()

    async def _open(self) -> Dds:
        config = configuration(os.environ, self.localhost, self.peers)
        while True:
            try:
                dds = await asyncio.to_thread(Dds, self.domain, config)
            except NoDds as error:
                self.problems.tell("DDS", f"{error} (are the network and CYCLONEDDS_URI right?)")
                await asyncio.sleep(AGAIN_S)
            else:
                self.problems.over("DDS")
                return dds


async def _with_reasons(liveness: Liveness) -> dict[str, Runs]:
    """Return which nodes run, or why not."""
    found = await liveness.look()
    return {name: liveness.why.get(name, False) if runs is False else runs for name, runs in found.items()}


class _Named:
    """The node, whose samples become messages that name their publisher."""

    def __init__(self, node: DdsNode) -> None:
        self._node = node

    def subscribe(self, topic: str, on_message: OnMessage) -> None:
        self._node.subscribe(topic, self._handing(on_message))

    def publish(self, topic: str, kind: str) -> ToldByUs:
        return self._node.publish(topic, kind)

    def read_now(self) -> None:
        self._node.read_now()

    @property
    def unheard(self) -> Unheard:
        return self._node.unheard

    @property
    def unseen(self) -> set[str]:
        return self._node.unseen

    def publishers(self, topic: str) -> tuple[str, ...]:
        return self._node.publishers(topic)

    def mismatches(self) -> dict[str, str]:
        return self._node.mismatches()

    def _handing(self, on_message: OnMessage) -> Callable[[Endpoint, Sample], None]:
        found = self._node.found

        def handed(writer: Endpoint, sample: Sample) -> None:
            name = found.name_of(writer)
            told = (writer.type, writer.type_hash, writer.key or sample.writer, name, sample.time_ns)
            on_message(Message(sample.data, *told, latched=bool(writer.durability and writer.reliable)))

        return handed
