"""A drill's plan: what each fault that could be planted would show, and what is diagnosed then: its promise.

Nothing is planted here. What a fault would show is read off the diagnosis' own theory: what follows from all
components being healthy, and not without this one (or without this topic), is lost, with what the drivers of
a device publish; but a process that is halted still runs, and a device that is unplugged still has its power.
So the promise is what the engine says of just these observations, for a fault that shows itself wherever it
can.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.model.components import ComponentModel
from robomend.model.packed import opened
from robomend.model.system import System
from robomend.planning.faults import DrilledBoard, Plantable, drivers_of, kept_by, plantable, taken_by
from robomend.planning.prediction import Theory, theory_of
from robomend.planning.protection import Protection
from robomend_client.literals import Atom, Literal

MOST_FAULTS = 500
"""Faults of one plan; what is left out is said."""

DIAGNOSIS_S = 5.0
"""Of each promise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantableFault(Plantable):
    """One fault of a drill's plan."""

    shows: tuple[Literal, ...]  # of what is observed, what would no longer hold
    diagnoses: tuple[tuple[str, ...], ...]  # of just that, the first ones; empty: nothing would be noticed
    remedies: tuple[str, ...] = ()  # of the model, that mend what is at fault

    @property
    def promise(self) -> str:
        """What a drill is held to: unseen, told (the only diagnosis), among (one of several) or missed."""
        if not self.shows or self.diagnoses == ((),):
            return "unseen"
        if self.diagnoses == ((self.component,),):
            return "told"
        return "among" if (self.component,) in self.diagnoses else "missed"


def drill_plan(
    system: System,
    parts: ComponentModel,
    observed: Collection[Atom],
    *,
    protected: Protection,
    board: DrilledBoard | None,
    meant_off: Collection[str] = (),
) -> Iterator[PlantableFault]:
    """Yield every fault that could be planted on a robot, in the order of its model.

    Args:
        observed: what its observers report.
        protected, board, meant_off: see `plantable`.
    """
    cnf = opened(system.cnf)
    theory = theory_of(cnf)
    healthy = theory.derived(parts.components)
    reported = [literal for literal in sorted(healthy) if literal.atom in observed]
    engine = make_engine("sat", cnf)
    try:
        for fault in plantable(parts, protected, board, meant_off=meant_off):
            taken = taken_by(parts, fault.kind, fault.component)
            drivers = drivers_of(parts, taken)
            left, kept = _left(theory, parts, fault, drivers), kept_by(fault.kind, taken, drivers)
            lost = tuple(-one for one in reported if one not in left and one.atom not in kept)
            seen = [one for one in reported if -one not in lost]
            found = engine.diagnose([*seen, *lost], Options(conflicts=False, timeout_s=DIAGNOSIS_S))
            blamed = tuple(diagnosis.bad for diagnosis in found.diagnoses)
            yield PlantableFault(
                fault.kind,
                fault.component,
                fault.act,
                fault.undo,
                fault.refused,
                fault.topic,
                shows=lost,
                diagnoses=blamed,
                remedies=tuple(str(one) for one in parts.remedies if fault.component in one.mends),
            )
    finally:
        engine.close()


def _left(
    theory: Theory, parts: ComponentModel, fault: Plantable, drivers: Collection[str]
) -> frozenset[Literal]:
    """Return what still follows from the model when a fault is there."""
    if fault.topic is not None:
        return theory.derived(parts.components, without=[Literal(Atom("ok", (fault.topic,)))])
    gone = taken_by(parts, fault.kind, fault.component) | set(drivers)
    return theory.derived(name for name in parts.components if name not in gone)
