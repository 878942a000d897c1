"""The bridge as a feed: the section `zenoh:` of the agent's file."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

from robomend_client.agent.feeds import Deliver
from robomend_client.bridges.ros2.base import Ros2Bridge
from robomend_client.bridges.zenoh.node import Liveness, ZenohNode
from robomend_client.bridges.zenoh.session import NoZenoh, ZenohSession
from robomend_client.yaml_reader import Section

ROUTER = "tcp/localhost:7447"
"""Where rmw_zenoh's router is."""

AGAIN_S = 3.0


class Zenoh(Ros2Bridge):
    """The feed `zenoh`: ROS 2 over zenoh."""

    folder = "zenoh-observations"

    def __init__(self, section: Section, base: Path, sources: frozenset[str]) -> None:
        super().__init__(section, base, sources, "zenoh")
        section.explain(
            config="a file with zenoh's own configuration, as the robot's nodes have it; by default "
            "ZENOH_SESSION_CONFIG_URI, or none",
            connect=f"where others are, as zenoh writes it, a list; by default {ROUTER}, or what config says",
        )
        config = section.optional("config")
        self.config = str(base / config) if config else os.environ.get("ZENOH_SESSION_CONFIG_URI") or None
        given = section.texts("connect")
        self.connect = given if "connect" in section or self.config else (ROUTER,)

    async def run(self, deliver: Deliver) -> None:
        """Be a node of the domain, and deliver what it hears, until cancelled."""
        await self.import_reader()
        session = await self._open()
        try:
            where = ", ".join(self.connect) or str(self.config)
            node = ZenohNode(self.node_name, self.domain, where, self.problems, self.discovery_s)
            liveness = Liveness(node, session, self.discovery_s)
            await self.be(node, node.run(session), liveness.look, lambda: False, deliver)
        finally:
            session.close()

    async def _open(self) -> ZenohSession:
        while True:
            try:
                session = await asyncio.to_thread(ZenohSession, self.connect, self.config)
            except NoZenoh as error:
                self.problems.tell("the session", f"cannot be opened: {error}")
                await asyncio.sleep(AGAIN_S)
            else:
                self.problems.over("the session")
                return session
