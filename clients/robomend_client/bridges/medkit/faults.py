"""Faults as diagnostic statuses: one for each entity that the gateway knows, and one for each fault.

    lidar_driver                          ERROR "LIDAR_RANGE_INVALID"   the worst of its active faults, or OK
    lidar_driver: LIDAR_RANGE_INVALID     ERROR "min_range > max_range" OK, when it was cleared

A fault is active while it is PREFAILED or CONFIRMED. INFO is OK, WARN is WARN, ERROR and CRITICAL are ERROR.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

OK, WARN, ERROR = range(3)
LEVELS = {"INFO": OK, "WARN": WARN, "ERROR": ERROR, "CRITICAL": ERROR}
NUMBERED = (OK, WARN, ERROR, ERROR)
INACTIVE = ("CLEARED", "HEALED", "PREPASSED")
CLEARED = "fault_cleared"
"""The event that ends a fault; all others say how it stands."""

MOST_FAULTS = 1000
MOST_ENTITIES = 1000
LONGEST = 500
"""Letters of a text of the gateway's that are kept."""


class BadFault(ValueError):
    """It is no fault."""


@dataclass(frozen=True)
class MedkitFault:
    """What the gateway says of one code."""

    code: str
    level: int
    message: str
    sources: tuple[str, ...]  # who reports it: names of nodes, with their namespaces, or ids of entities
    active: bool = True
    entity: str | None = None  # of the one who reports it now, where the gateway says so


def read_fault(value: Any, entity: str | None = None) -> MedkitFault:
    """Return a fault; `entity` is one that the gateway itself has found to it.

    Raises:
        BadFault: this is none.
    """
    if not isinstance(value, Mapping) or not isinstance(code := value.get("fault_code"), str) or not code:
        raise BadFault(f"no fault: {str(value)[:200]}")
    sources = value.get("reporting_sources", value.get("source", ()))
    named = [sources] if isinstance(sources, str) else sources
    if not isinstance(named, list | tuple) or not all(isinstance(name, str) for name in named):
        raise BadFault(f"{code[:200]}: its sources are no names")
    message = value.get("description", value.get("message", ""))
    active = str(value.get("status", "")) not in INACTIVE
    return MedkitFault(
        code[:LONGEST], _level(value), str(message)[:LONGEST], tuple(filter(None, named)), active, entity
    )


def _level(value: Mapping[str, Any]) -> int:
    severity = value.get("severity")
    if isinstance(severity, str) and severity in LEVELS:
        return LEVELS[severity]
    if isinstance(severity, int) and not isinstance(severity, bool) and 0 <= severity < len(NUMBERED):
        return NUMBERED[severity]
    raise BadFault(f"{value['fault_code'][:200]}: its severity is {str(severity)[:80]!r}")


def read_entities(items: Iterable[Any]) -> dict[str, str]:
    """Return the ids of a list of entities, each with the node that it is, as far as the gateway says."""
    found = {}
    for item in items:
        if isinstance(item, Mapping) and item.get("id"):
            about = item.get("x-medkit")
            ros = about.get("ros2") if isinstance(about, Mapping) else None
            node = ros.get("node") if isinstance(ros, Mapping) else None
            found[str(item["id"])] = node if isinstance(node, str) else ""
    return found


class Faults:
    """All that is known of one gateway."""

    def __init__(self) -> None:
        self._faults: dict[str, MedkitFault] = {}
        self._told: dict[str, str] = {}  # source -> its entity, as an event has said
        self.have({})

    def have(self, entities: Mapping[str, str]) -> None:
        """The gateway has these: id -> the node that it is, where the gateway says so."""
        self.entities = frozenset(entities)
        self._by_node = {node.strip("/"): entity for entity, node in entities.items() if node}
        self._by_id = {_plain(entity): entity for entity, node in entities.items() if not node}
        self._by_source: dict[str, str] = {}  # what was found by them

    def stand(self, active: Iterable[MedkitFault]) -> None:
        """These are active, and no others."""
        now = {fault.code: fault for fault in active}
        for code, fault in self._faults.items():
            if code not in now:
                now[code] = replace(fault, active=False)
        self._faults = dict(list(now.items())[:MOST_FAULTS])

    def event(self, kind: str, fault: MedkitFault) -> None:
        """Something has become of a fault."""
        if fault.entity is not None and len(fault.sources) == 1 and len(self._told) < MOST_ENTITIES:
            self._told[fault.sources[0]] = fault.entity
        if fault.code in self._faults or len(self._faults) < MOST_FAULTS:
            self._faults[fault.code] = replace(fault, active=fault.active and kind != CLEARED)

    def unknown(self) -> dict[str, str]:
        """Return the entities of active faults that the gateway does not list, with the fault's code."""
        told = (
            (entity, fault)
            for fault in self._faults.values()
            if fault.active
            for entity in self._entities(fault)
        )
        return {entity: fault.code for entity, fault in told if entity not in self.entities}

    def _entities(self, fault: MedkitFault) -> Iterable[str]:
        """Return who reports a fault, by their ids: all of them."""
        found = dict.fromkeys(map(self._entity, fault.sources))
        if fault.entity is not None:
            found.setdefault(fault.entity)
        return found

    def _entity(self, source: str) -> str:
        """Return the entity of a reporting source: the one that is this node, else the one whose id says so.

        In several namespaces a node's last name is not enough: /robot1/lidar_driver is robot1_lidar_driver.
        """
        found = self._told.get(source) or self._by_source.get(source)
        if found is None:
            parts = source.strip("/").split("/")
            ends = ("/".join(parts[place:]) for place in range(len(parts)))  # the longest that is one
            ids = (self._by_id.get(_plain(end)) for end in ends)
            found = self._by_node.get("/".join(parts)) or next(filter(None, ids), parts[-1])
            if len(self._by_source) < MOST_ENTITIES:
                self._by_source[source] = found
        return found

    def statuses(self) -> list[dict[str, Any]]:
        """Return all that stands, each with the fields of a DiagnosticStatus."""
        worst: dict[str, list[MedkitFault]] = {entity: [] for entity in sorted(self.entities)[:MOST_ENTITIES]}
        single = []
        for fault in self._faults.values():
            level = fault.level if fault.active else OK
            for entity in self._entities(fault):
                worst.setdefault(entity, [])
                if fault.active:
                    worst[entity].append(fault)
                single.append(_status(f"{entity}: {fault.code}", level, fault.message, entity))
        whole = [
            _status(
                entity,
                max((fault.level for fault in found), default=OK),
                ", ".join(fault.code for fault in found)[:LONGEST],
                entity,
            )
            for entity, found in worst.items()
        ]
        return whole + single


def _plain(name: str) -> str:
    """Return a name as ids write it: with nothing but letters and digits told apart."""
    return re.sub(r"[^a-z0-9]", "_", name.lower())


def _status(name: str, level: int, message: str, entity: str) -> dict[str, Any]:
    return {"name": name, "level": level, "message": message, "hardware_id": entity, "values": []}
