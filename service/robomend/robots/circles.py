"""Which circles of topics (robomend.model.loops) were up on a robot, and the system description with them.

Held in memory. After a restart of the service it is read off OBS, and off the last diagnosis: where that
rests on a circle's clause, the circle was up.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Iterable

from robomend.entry import Entry
from robomend.model.clauses import Assertion
from robomend.model.system import System
from robomend.observations.obs import Obs
from robomend.store.records import Json
from robomend_client.literals import Atom


class Circles:
    """Of one robot in memory."""

    __slots__ = ("_once_ok",)

    def __init__(self) -> None:
        self._once_ok: set[Atom] = set()

    def hear(self, entries: Iterable[Entry]) -> None:
        """Take note of what is seen to hold."""
        self._once_ok.update(entry.atom for entry in entries if entry.positive)

    def were_up(self, system: System, result: Json | None) -> None:
        """Take note of the circles that a stored diagnosis rests on."""
        conflicts = () if result is None else result.get("conflicts", ())
        told = {rule for conflict in conflicts for rule in conflict.get("rules", ())}
        for loop in system.loops:
            if loop.clause.text in told:
                self._once_ok.update(loop.atoms)

    def up(self, system: System, obs: Obs, stopped: Collection[str]) -> tuple[Assertion, ...]:
        """Return the clauses of the circles that were up, and of which no part is meant to be stopped."""
        return tuple(
            loop.clause
            for loop in system.loops
            if loop.components.isdisjoint(stopped)
            and loop.was_up((atom for atom in loop.atoms if obs.get(atom) is not None), self._once_ok)
        )


VARIANTS = 64
"""Systems as robots make them, kept: a fleet of one model has few, and each is as large as the model."""

_variants: OrderedDict[tuple[int, str], tuple[System, System]] = OrderedDict()


def extended(
    system: System, version: str, assertions: tuple[Assertion, ...], stopped: tuple[str, ...]
) -> System:
    """Return what `System.extended` makes of a system; the same for all robots of which that is so.

    `version`: see robomend.model.system.variant; equal ones are equal clauses.
    """
    key = (id(system), version)  # the entry keeps the system alive, so that no other gets its id
    known = _variants.pop(key, None) or (system, system.extended(assertions, stopped))
    _variants[key] = known
    while len(_variants) > VARIANTS:
        _variants.popitem(last=False)
    return known[1]
