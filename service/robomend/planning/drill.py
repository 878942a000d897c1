"""A drill's plan: faults that could be planted on a robot, what each would show and what is diagnosed then.

    node killed        its process is ended                    undone by starting it
    node frozen        its process is halted, and goes on      undone by letting it go on
    device off         its channel is switched off             undone by switching it on
    device unplugged   a person pulls its data cable           undone by plugging it in

Nothing is planted here. What a fault would show is read off the diagnosis' own theory: what follows from all
components being healthy, and not without this one, is lost, with what the drivers of a device publish; but a
process that is halted still runs, and a device that is unplugged still has its power. So the promise is what
the engine says of just these observations, for a fault that shows itself wherever it can.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import StrEnum

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.model.components import ComponentModel
from robomend.model.packed import opened
from robomend.model.system import System
from robomend.planning.influence import touched
from robomend.planning.prediction import theory_of
from robomend.planning.protection import Protection, protected_channels
from robomend_client.literals import Atom, Literal

MOST_FAULTS = 500
"""Faults of one plan; what is left out is said."""

DIAGNOSIS_S = 5.0
"""Of each promise."""


class FaultKind(StrEnum):
    """How a fault is planted."""

    KILLED = "node-killed"
    FROZEN = "node-frozen"
    OFF = "device-off"
    UNPLUGGED = "device-unplugged"


BY = {
    FaultKind.KILLED: "agent",
    FaultKind.FROZEN: "agent",
    FaultKind.OFF: "board",
    FaultKind.UNPLUGGED: "a person",
}


@dataclass(frozen=True, slots=True)
class Plantable:
    """A fault that could be planted, or never is."""

    kind: FaultKind
    component: str
    act: str
    undo: str
    refused: str | None  # why it is not planted


@dataclass(frozen=True, slots=True)
class PlantableFault(Plantable):
    """One fault of a drill's plan."""

    shows: tuple[Literal, ...]  # of what is observed, what would no longer hold
    diagnoses: tuple[tuple[str, ...], ...]  # of just that, the first ones; empty: nothing would be noticed

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
    board: Collection[int] | None,
) -> Iterator[PlantableFault]:
    """Yield every fault that could be planted on a robot, in the order of its model.

    Args:
        observed: what its observers report.
        protected: what nothing switches off or stops, and why.
        board: the channels that its configuration protects; None: it has no power board.
    """
    cnf = opened(system.cnf)
    theory = theory_of(cnf)
    healthy = theory.derived(parts.components)
    reported = [literal for literal in sorted(healthy) if literal.atom in observed]
    engine = make_engine("sat", cnf)
    try:
        for fault in plantable(parts, protected, board):
            component = fault.component
            drivers = drivers_of(parts, component)
            left = theory.derived(n for n in parts.components if n != component and n not in drivers)
            kept = _kept(fault.kind, component, drivers)
            lost = tuple(-one for one in reported if one not in left and one.atom not in kept)
            seen = [one for one in reported if -one not in lost]
            found = engine.diagnose([*seen, *lost], Options(conflicts=False, timeout_s=DIAGNOSIS_S))
            blamed = tuple(diagnosis.bad for diagnosis in found.diagnoses)
            yield PlantableFault(fault.kind, component, fault.act, fault.undo, fault.refused, lost, blamed)
    finally:
        engine.close()


def _kept(kind: FaultKind, component: str, drivers: Collection[str]) -> frozenset[Atom]:
    """Return what goes on holding: a halted process runs, an unplugged device is on, its drivers run."""
    kept = {Atom("running", (name,)) for name in drivers}
    if kind is FaultKind.FROZEN:
        kept.add(Atom("running", (component,)))
    elif kind is FaultKind.UNPLUGGED:
        kept.add(Atom("on", (component,)))
    return frozenset(kept)


def drivers_of(parts: ComponentModel, component: str) -> frozenset[str]:
    """Return the nodes that drive a device, or one that it feeds; none of a node."""
    devices = touched(parts, [component]) & parts.hardware.keys()
    return frozenset(name for name, node in parts.nodes.items() if devices.intersection(node.drives))


def _driver_kept(parts: ComponentModel, device: str, protected: Protection) -> str | None:
    """Return why a driver that would have to be restarted afterwards may not be."""
    kept = sorted(name for name in drivers_of(parts, device) if name in protected)
    return f"its driver {kept[0]} would have to be restarted, and is protected" if kept else None


def plantable(
    parts: ComponentModel, protected: Protection, board: Collection[int] | None
) -> Iterator[Plantable]:
    """Yield every fault of a robot in the order of its model; see `drill_plan`."""
    channels = protected_channels(parts, protected, board or ())
    for name, device in parts.hardware.items():
        why = protected.get(name) or _driver_kept(parts, name, protected)
        if device.channel is not None:
            off = why or channels.get(device.channel)
            if off is None and board is None:
                off = "the robot has no `board` that could switch it"
            where = f"channel {device.channel}"
            yield Plantable(FaultKind.OFF, name, f"switch off {where}", f"switch on {where}", off)
        yield Plantable(FaultKind.UNPLUGGED, name, f"pull the data cable of {name}", "plug it in", why)
    for name, node in parts.nodes.items():
        why = protected.get(name)
        killed = why
        if killed is None and not node.restartable:
            killed = "nothing restarts it, so that there is no undo"
        yield Plantable(FaultKind.KILLED, name, f"kill the process of {name}", f"start {name}", killed)
        yield Plantable(FaultKind.FROZEN, name, f"halt the process of {name}", "let it go on", why)
