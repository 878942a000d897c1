"""The feed `medkit`: faults of a gateway, as diagnostic statuses.

every poll_s   entities and faults ──┐
stream         events ───────────────┴──► statuses, at once and every TABLE_S

When the gateway does not answer, nobody looks, and observers are told so. Without the stream the faults are
asked for every TABLE_S, so that what is said is never older than that.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

from robomend_client.agent.feeds import Deliver
from robomend_client.bridges.medkit.faults import (
    BadFault,
    Faults,
    MedkitFault,
    read_entities,
    read_fault,
)
from robomend_client.bridges.medkit.gateway import Gateway, NoGateway
from robomend_client.bridges.problems import Problems
from robomend_client.observers import Contact
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
            poll_s="how often entities and faults are asked for, in seconds; the stream says what happens, "
            "and without it faults are asked for every second",
        )
        self.url = section.text("url", "http://localhost:8080/api/v1")
        if not self.url.startswith(("http://", "https://")):
            raise section.error("url", f"must be like http://localhost:8080/api/v1, not {self.url!r}")
        self.token_env = section.optional("token_env")
        self.poll_s = section.number("poll_s", 5.0, least=0.1, most=3600)
        self._sources = sources
        for source in sources - {DIAGNOSTICS}:
            raise section.error(
                "url", f"the gateway has one source, {DIAGNOSTICS}; an observer wants {source!r}"
            )
        self.problems = Problems("ros2_medkit")
        self._faults = Faults()
        self._events = 0
        self._streams = False
        self._sees: bool | None = None

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
        entities_s = float("-inf")  # when they were asked for
        while True:
            began_s = time.monotonic()
            try:
                if began_s - entities_s >= self.poll_s:
                    entities = await self._answer(self._entities(gateway), deliver)
                    entities_s = began_s
                    self._faults.have(read_entities(entities))
                found = await self._answer(self._list(gateway), deliver)
            except NoGateway as error:
                entities_s = float("-inf")
                self._see(False, deliver)
                self.problems.tell("the gateway", str(error))
                await asyncio.sleep(min(self.poll_s, AGAIN_S))
                continue
            self.problems.over("the gateway")
            self._faults.stand(fault for item in found if (fault := self._read(item)))
            self._see(True, deliver)
            self._deliver(deliver)
            while (left_s := began_s + self._period_s - time.monotonic()) > 0:
                await asyncio.sleep(min(left_s, TABLE_S))
                if self._streams:
                    self._deliver(deliver)

    @property
    def _period_s(self) -> float:
        return self.poll_s if self._streams else min(self.poll_s, TABLE_S)

    async def _answer(self, asking: Coroutine[Any, Any, list[Any]], deliver: Deliver) -> list[Any]:
        """Wait for the gateway's answer; one that takes long to answer is not looked at meanwhile."""
        task = asyncio.create_task(asking)
        try:
            await asyncio.wait({task}, timeout=TABLE_S)
            if not task.done():
                self._see(False, deliver)
            return await task
        finally:
            await end([task])

    async def _entities(self, gateway: Gateway) -> list[Any]:
        return [item for kind in ENTITIES for item in await gateway.items(f"/{kind}")]

    def _see(self, sees: bool, deliver: Deliver) -> None:
        """Tell observers whether the gateway is looked at."""
        if sees is not self._sees:
            self._sees = sees
            for source in self._sources:
                deliver(source, Contact.BACK if sees else Contact.LOST, None)

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
                async for events in gateway.stream("/faults/stream", decoder):
                    self._streams = True
                    self.problems.over("the stream")
                    for event in events:
                        self._event(event.name, event.data)
                    if events:
                        self._deliver(deliver)
            except NoGateway as error:
                if self._sees:  # else it is told already
                    self.problems.tell("the stream", str(error))
            self._streams = False
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
        if not self._sees:
            return  # nobody knows what else there is
        for entity, code in self._faults.unknown().items():
            self.problems.tell(f"entity {entity}", f"has the fault {code}, and the gateway does not list it")
        deliver(DIAGNOSTICS, self._faults.statuses(), None)
