"""What becomes of a planted fault: what showed, what was diagnosed, and what repaired it.

planted ── a diagnosis that is not healthy: seen ── a repair begins, of the drill ── it ends
   │                                        └────── healthy again without one: it went by itself
   ├── nothing is seen in `detect_s`
   └── `bound_s` is over                        … each ends the watching, and the fault is undone
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection, Iterable
from typing import Any

from robomend.drills.record import DrillRecord
from robomend.model.components import ComponentModel
from robomend.planning.faults import LINE_FAULTS, drivers_of, taken_by
from robomend.planning.influence import influenced
from robomend.planning.prediction import OBSERVED_FACTS, theory_of
from robomend.poller import wait_for
from robomend.repairs.foresight import doubts
from robomend.repairs.states import RepairState
from robomend.robots.clock import CLOCK
from robomend.robots.health import HealthState, health_of
from robomend.robots.robot import Robot
from robomend.robots.sight import SLACK_NS
from robomend.store import Store, View, repairs
from robomend.store.records import Paging, StepRecord, StoredRepair
from robomend_client.literals import Atom

LOOK_S = 0.2
"""How often it is looked at the clock as well: events wake us before."""

GONE_S = 10.0
"""What was known before the fault and is unknown for so long: whoever reports it is gone. An agent that gets
no processor says nothing of a silent topic for half of that."""

CALM_S = 2.0
"""A robot that is healthy again for so long without a repair is well."""

MOST_DIAGNOSES = 20
"""Kept of the last one before the first act."""


class Gone(Exception):  # what happened, not what went wrong
    """Nobody reports any more what was reported before: the fault cannot be watched."""


class Watching:
    """Of one drill; made before the fault is planted."""

    def __init__(
        self, store: Store, state: Robot, record: DrillRecord, *, hold_s: float, news: asyncio.Event
    ) -> None:
        """`news` is set when something may have changed."""
        self._store = store
        self._state = state
        self._record = record
        self._calm_s = hold_s + CALM_S
        self._news = news
        self._before = frozenset(state.literals())
        self._known = frozenset(
            atom
            for atom in state.sight.observed
            if state.sight.reported(atom) and not (record.kind in LINE_FAULTS and of_board(atom))
        )
        self._planted_s = 0.0
        self._planted_ns = 0
        self._seen_s: float | None = None
        self._showed: dict[str, float] = {}
        self._doubts: dict[str, dict[str, str]] = {}
        self._diagnosed: list[tuple[int, tuple[tuple[str, ...], ...]]] = []

    def planted(self) -> None:
        """The act is being sent, or was done by a person: from here on what is seen counts."""
        self._planted_s, self._planted_ns = time.monotonic(), time.time_ns()

    async def watch(self) -> None:
        """Return when there is nothing more to be seen; Gone when it cannot be seen."""
        well_since: float | None = None
        gone_since: float | None = None
        while True:
            self._news.clear()
            now = time.monotonic()
            after_s = now - self._planted_s
            await self._state.refreshed()
            self._look(after_s)
            repair = await self._store.read(lambda view: repair_of(view, self._record))
            how, unknown = health_of(self._state)
            missing = self._known.intersection(unknown)
            # A repair also ends because nobody tells of its symptoms any more.
            if (
                repair is not None
                and not repair.open
                and not (missing and repair.state != RepairState.REPAIRED)
            ):
                return
            if after_s >= self._record.data["bound_s"]:
                return
            if self._seen_s is None and after_s >= self._record.data["detect_s"]:
                return
            well = self._seen_s is not None and repair is None and how is HealthState.HEALTHY
            well_since = (well_since or now) if well else None
            if well_since is not None and now - well_since >= self._calm_s:
                return
            gone_since = (gone_since or now) if missing else None
            if gone_since is not None and now - gone_since >= GONE_S:
                raise Gone(f"nobody reports {', '.join(map(str, sorted(missing)[:5]))} any more")
            await wait_for(self._news, LOOK_S)

    def _look(self, after_s: float) -> None:
        current = self._state.current
        for literal in self._state.literals():
            if -literal in self._before:
                self._showed.setdefault(str(literal), round(after_s, 3))
        entries = self._state.sight.entries()
        self._doubts |= {one["text"]: one for one in doubts(self._state.system.parts, entries)}
        if current is None or current.healthy or not current.bad_sets:
            return
        if self._seen_s is None:
            self._seen_s = max(0.0, (current.time_ns - self._planted_ns) / 1e9)
        if not self._diagnosed or self._diagnosed[-1][1] != current.bad_sets:
            self._diagnosed.append((current.time_ns, current.bad_sets))
            del self._diagnosed[: -10 * MOST_DIAGNOSES]

    async def seen(self) -> dict[str, Any]:
        """Return what was seen, as JSON."""
        parts = self._state.system.parts
        assert parts is not None

        def look(view: View) -> tuple[StoredRepair | None, tuple[StepRecord, ...]]:
            repair = repair_of(view, self._record)
            return repair, () if repair is None else repairs.steps(view, repair.id)

        repair, steps = await self._store.read(look)
        sent = [step.data for step in steps if step.data.get("sent_ns")]
        first_ns = min((one["sent_ns"] for one in sent), default=None)
        until = [bad for at_ns, bad in self._diagnosed if first_ns is None or at_ns <= first_ns]
        repaired = repair is not None and repair.state == RepairState.REPAIRED
        ends_ns = None if repair is None or repair.open else repair.updated_ns
        meant = meant_by(parts, taken_by(parts, self._record.kind, self._record.component))
        mends = {str(one): one.mends for one in parts.remedies}
        return {
            "detected_s": None if self._seen_s is None else round(self._seen_s, 3),
            "diagnoses": [list(bad) for bad in (until[-1] if until else ())[:MOST_DIAGNOSES]],
            "showed": self._showed,
            "doubts": list(self._doubts.values())[:MOST_DIAGNOSES],
            "acted_s": None if first_ns is None else round((first_ns - self._planted_ns) / 1e9, 3),
            "repair": None if repair is None else repair.id,
            "repair_state": None if repair is None else repair.state,
            "repair_reason": None if repair is None else repair.data.get("reason", ""),
            "repaired_s": round((ends_ns - self._planted_ns) / 1e9, 3) if repaired and ends_ns else None,
            "acts": [one["text"] for one in sent],
            "needless": [
                one["text"]
                for one in sent
                if not is_meant(mends.get(one["text"]) or one["parameters"], meant, parts.components)
            ],
        }


def repair_of(view: View, record: DrillRecord) -> StoredRepair | None:
    """Return the newest repair that answers a drill."""
    found = repairs.page(view, record.robot, Paging(limit=1)).items
    return found[0] if found and found[0].data.get("drill") == record.id else None


def left_off_by(view: View, robot: str) -> frozenset[str]:
    """Return what the robot's last repair switched off or stopped, and did not bring back."""
    found = repairs.page(view, robot, Paging(limit=1)).items
    return frozenset(found[0].data.get("left_off") or ()) if found else frozenset()


def of_board(atom: Atom) -> bool:
    """Return whether the power board itself says it, so that nobody does while its line is disturbed."""
    return atom.predicate == "on" or (atom.predicate == "ok" and atom.args[:1] == ("current",))


def acted_on_by_repair(view: View, record: DrillRecord) -> frozenset[str]:
    """Return the components that the repair which answers a drill has acted on."""
    repair = repair_of(view, record)
    steps = () if repair is None else repairs.steps(view, repair.id)
    return frozenset(name for step in steps if step.data.get("sent_ns") for name in step.data["parameters"])


def meant_by(parts: ComponentModel, components: Collection[str]) -> frozenset[str]:
    """Return what a repair of components acts on: them, their drivers, and what is tied to these."""
    meant = {*components, *drivers_of(parts, components)}
    while new := {name for name, node in parts.nodes.items() if meant.intersection(node.tied_to)} - meant:
        meant |= new
    return frozenset(meant)


def is_meant(acted_on: Iterable[str], meant: Collection[str], components: Iterable[str]) -> bool:
    """Return whether an act was on what was faulty, and on nothing else of the robot."""
    return set(acted_on).intersection(components) <= set(meant)


def resting_on(state: Robot, components: Collection[str]) -> frozenset[Atom]:
    """Return what is observed and rests on these components; not whether they are on, or run."""
    parts = state.system.parts
    if parts is None:
        return frozenset()
    known = [entry.atom for entry in state.obs.entries() if entry.atom.predicate not in OBSERVED_FACTS]
    return influenced(parts, theory_of(state.system.cnf), frozenset(components), known)


def not_heard_since(state: Robot, atoms: Iterable[Atom], time_ns: int) -> list[Atom]:
    """Return those of which all that is known is that they held before that time, or so soon after it that
    their observer could not have noticed yet.

    Who speaks on change only is heard by its silence.
    """
    found, now_ns = [], CLOCK.now_ns()
    for atom in sorted(atoms):
        entry, noticed_ns = state.obs.get(atom), time_ns + state.sight.delays(atom).detection_ns
        if entry is None or not entry.positive or entry.time_ns > noticed_ns:
            continue
        if max(entry.since_ns or 0, state.sight.rose_ns(atom) or 0) > time_ns:
            continue
        if entry.expires_ns is not None or now_ns <= noticed_ns + SLACK_NS:
            found.append(atom)
    return found


async def heard(
    state: Robot, within_s: float, news: asyncio.Event, unheard: Callable[[], Collection[Atom]]
) -> None:
    """Wait until nothing is unheard, for so long at most."""
    deadline = time.monotonic() + within_s
    while unheard() and time.monotonic() < deadline:
        news.clear()
        await wait_for(news, LOOK_S)
        await state.refreshed()


async def healthy_for(
    state: Robot, hold_s: float, within_s: float, news: asyncio.Event, unheard: Callable[[], Collection[Atom]]
) -> bool:
    """Wait for a robot to be healthy, with nothing unheard and without a break; return whether it was."""
    deadline = time.monotonic() + within_s
    since: float | None = None
    while True:
        news.clear()
        await state.refreshed()
        now = time.monotonic()
        well = health_of(state)[0] is HealthState.HEALTHY and not unheard()
        since = (since or now) if well else None
        if since is not None and now - since >= hold_s:
            return True
        if now >= deadline + hold_s or (since is None and now >= deadline):
            return False
        await wait_for(news, LOOK_S)
