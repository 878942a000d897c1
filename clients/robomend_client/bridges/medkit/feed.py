"""The feed `medkit`: faults of a gateway, as diagnostic statuses.

every poll_s   entities and faults ──┐
stream         events ───────────────┴──► statuses, at once and every TABLE_S

When the gateway does not answer, nothing is said any more: what observers hold of it is unknown when its
lifetime is over.
"""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

from robomend_client.agent.feeds import Deliver
from robomend_client.bridges.medkit.faults import BadFault, Faults, MedkitFault, read_fault
from robomend_client.bridges.medkit.gateway import Gateway, NoGateway
from robomend_client.bridges.problems import Problems
from robomend_client.python310 import end
from robomend_client.rest.sse import EventDecoder
from robomend_client.yaml_reader import Section

DIAGNOSTICS = "diagnostics"
"""The one source."""

TABLE_S = 1.0
AGAIN_S = 3.0
TIMEOUT_S = 5.0
MOST_LISTS = 3
ENTITIES = ("apps", "components")


class Medkit:
    """The feed."""

    def __init__(self, section: Section, base: Path, sources: frozenset[str]) -> None:
        section.explain(
            url="the gateway's, as far as /api/v1",
            token_env="the variable of the agent's environment that has the gateway's bearer token",
            poll_s="how often entities and faults are asked for, in seconds; a stream says what happens",
        )
        self.url = section.text("url", "http://localhost:8080/api/v1")
        if not self.url.startswith(("http://", "https://")):
            raise section.error("url", f"must be like http://localhost:8080/api/v1, not {self.url!r}")
        self.token_env = section.optional("token_env")
        self.poll_s = section.number("poll_s", 5.0, least=0.1, most=3600)
        for source in sources - {DIAGNOSTICS}:
            raise section.error(
                "url", f"the gateway has one source, {DIAGNOSTICS}; an observer wants {source!r}"
            )
        self.problems = Problems("ros2_medkit")
        self._faults = Faults()
        self._events = 0
        self._known_s: float | None = None  # when the gateway has last answered

    async def run(self, deliver: Deliver) -> None:
        """Deliver until cancelled."""
        gateway = Gateway(self.url, self.token_env, TIMEOUT_S)
        work = (self._poll(gateway, deliver), self._stream(gateway, deliver))
        tasks = [asyncio.create_task(part) for part in work]
        try:
            await asyncio.gather(*tasks)
        finally:
            await end(tasks)
            await gateway.close()

    async def _poll(self, gateway: Gateway, deliver: Deliver) -> None:
        """Ask for all there is, now and then; say it again and again meanwhile."""
        while True:
            try:
                entities = [item for kind in ENTITIES for item in await gateway.items(f"/{kind}")]
                found = await self._list(gateway)
            except NoGateway as error:
                self._known_s = None
                self.problems.tell("the gateway", str(error))
                await asyncio.sleep(min(self.poll_s, AGAIN_S))
                continue
            self.problems.over("the gateway")
            self._faults.entities = frozenset(map(str, filter(None, map(_id, entities))))
            self._faults.stand(fault for item in found if (fault := self._read(item)))
            self._known_s = time.monotonic()
            while (left_s := self.poll_s - (time.monotonic() - self._known_s)) > 0:
                self._deliver(deliver)
                await asyncio.sleep(min(left_s, TABLE_S))

    async def _list(self, gateway: Gateway) -> list[Any]:
        """Return the active faults, of a moment after which no event has come, if there is one."""
        for _ in range(MOST_LISTS):
            events = self._events
            found = await gateway.items("/faults")
            if events == self._events:
                break
        return found

    async def _stream(self, gateway: Gateway, deliver: Deliver) -> None:
        """Take in what happens, at once."""
        decoder = EventDecoder()
        while True:
            try:
                async for event in gateway.stream("/faults/stream", decoder):
                    self.problems.over("the stream")
                    self._event(event.name, event.data)
                    self._deliver(deliver)
            except NoGateway as error:
                if self._known_s is not None:  # else it is told already
                    self.problems.tell("the stream", str(error))
            await asyncio.sleep(AGAIN_S)

    def _event(self, name: str, text: str) -> None:
        self._events += 1
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):
            value = None
        if not isinstance(value, dict):
            self.problems.tell("an event", f"{name[:80]!r} is no object")
            return
        about = value.get("x-medkit")
        entity = about.get("entity_id") if isinstance(about, dict) else None
        fault = self._read(value.get("fault"), entity if isinstance(entity, str) else None)
        if fault is not None:
            self._faults.event(str(value.get("event_type", name)), fault)

    def _read(self, value: Any, entity: str | None = None) -> MedkitFault | None:
        try:
            return read_fault(value, entity)
        except BadFault as error:
            self.problems.tell("a fault", str(error))
            return None

    def _deliver(self, deliver: Deliver) -> None:
        if self._known_s is None:
            return  # nobody knows what else there is
        for entity, code in self._faults.unknown().items():
            self.problems.tell(f"entity {entity}", f"has the fault {code}, and the gateway does not list it")
        deliver(DIAGNOSTICS, self._faults.statuses(), None)


def _id(item: Any) -> object:
    return item.get("id") if isinstance(item, dict) else None
