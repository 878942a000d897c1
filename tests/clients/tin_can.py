"""A feed as another distribution would have one, for tests."""

from __future__ import annotations

import asyncio
from pathlib import Path

from robomend_client.agent.feeds import Deliver
from robomend_client.yaml_reader import Section


class TinCan:
    """Delivers each source ten times a second."""

    def __init__(self, section: Section, base: Path, sources: frozenset[str]) -> None:
        self.string_m = section.number("string_m", 10.0)
        self.sources = sources

    async def run(self, deliver: Deliver) -> None:
        while True:
            for source in sorted(self.sources):
                deliver(source, None, None)
            await asyncio.sleep(0.1)
