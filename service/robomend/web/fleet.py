"""All robots in one list: how each is, what is wrong, what it waits for. Made for thousands.

    events of the store ──► which robots changed ──► their lines made anew when somebody looks
                                                     all others as they were

A line is made of what memory holds of the robot, which reads it from the store where it must, and of the
robot's newest repair. An event is told a moment before memory shows what it is about, or a moment after:
a line is made anew with each look for `SETTLES_S` after its robot's last event.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from robomend.errors import RobomendError
from robomend.repairs.headline import Headline, of_robot
from robomend.repairs.repair_json import repair_json
from robomend.repairs.states import RepairState
from robomend.robots.health import HealthState, health_of
from robomend.robots.memory import Memory
from robomend.robots.robot import Robot
from robomend.store import Store, View, repairs, robots
from robomend.store.records import Paging
from robomend.web.words import listed, waits_for
from robomend_client.events import Event, Kind

SETTLES_S = 2.0
"""After an event of a robot, its line is made anew with each look."""

LOOK_S = 0.4
"""For robots that are not in memory: the rest is read with the next looks."""

TOLD = frozenset({Kind.DIAGNOSIS, Kind.REPAIR, Kind.CONFIGURATION, Kind.ROBOT, Kind.BOARD})
"""Kinds of events that may change a line."""

WORST_FIRST = {
    HealthState.UNHEALTHY: 0,
    HealthState.UNKNOWN: 1,
    HealthState.DEGRADED: 2,
    HealthState.PARTLY_UNKNOWN: 3,
    HealthState.HEALTHY: 4,
}

WAITING = "waiting"
"""Besides the states of health: those that wait for a person."""


@dataclass(frozen=True, slots=True)
class Line:
    """One robot of the list."""

    id: str
    model: str
    policy: str
    state: HealthState | None  # None: not read yet
    finding: str = ""  # the leading diagnosis, or why there is none
    more: int = 0  # diagnoses besides it
    waits: str = ""
    waits_for_person: bool = False
    since_ns: int | None = None  # of the diagnosis
    headline: Headline | None = None

    @property
    def rank(self) -> tuple[bool, int, str]:
        """Where it stands in the list: who waits for a person first, then by state, then by name."""
        return not self.waits_for_person, WORST_FIRST.get(self.state, 4) if self.state else 4, self.id

    def found_by(self, words: Sequence[str], state: str) -> bool:
        """Return whether a search and a filter let it through."""
        fits = self.waits_for_person if state == WAITING else self.state == state
        if state and not fits:
            return False
        said = "" if self.headline is None else self.headline.text(self.since_ns or 0)
        text = f"{self.id} {self.model} {self.policy} {self.finding} {self.waits} {said}".casefold()
        return all(word in text for word in words)


@dataclass(frozen=True, slots=True)
class FleetPage:
    """A page of the list, and how many there are of each kind in all."""

    lines: Sequence[Line]
    found: int
    total: int
    counts: dict[str, int]
    number: int
    pages: int
    complete: bool  # every robot was read


class Fleet:
    """See the module. Belongs to one event loop."""

    def __init__(self, store: Store, memory: Memory) -> None:
        self._store = store
        self._memory = memory
        self._lines: dict[str, Line] = {}
        self._changed: dict[str, float] = {}  # robot -> until when its line is made anew
        self._listening = False
        self._listed = False

    async def page(self, *, search: str, state: str, number: int, rows: int) -> FleetPage:
        """Return a page of the lines that a search and a filter leave, the most urgent first."""
        await self._refresh()
        words = search.casefold().split()
        lines = self._lines.values()
        counts: dict[str, int] = {str(each): 0 for each in HealthState} | {WAITING: 0}
        for line in lines:
            if line.state is not None:
                counts[line.state] += 1
            counts[WAITING] += line.waits_for_person
        found = sorted((line for line in lines if line.found_by(words, state)), key=lambda line: line.rank)
        pages = max(1, -(-len(found) // rows))
        number = min(max(1, number), pages)
        shown = found[(number - 1) * rows : number * rows]
        complete = all(line.state is not None for line in lines)
        return FleetPage(shown, len(found), len(lines), counts, number, pages, complete)

    def _follow(self, events: Sequence[Event]) -> None:
        until = time.monotonic() + SETTLES_S
        for event in events:
            if event.robot is not None and event.kind in TOLD:
                self._changed[event.robot] = until
                if event.kind is Kind.ROBOT and event.data.get("what") != "health":
                    self._listed = False

    async def _refresh(self) -> None:
        """Make the lines anew of robots that changed since the last look."""
        if not self._listening:
            self._listening = True
            self._store.subscribe(self._follow)
        if not self._listed:
            self._listed = True  # before reading: what changes meanwhile is read again
            try:
                await self._list()
            except BaseException:  # a look that is given up as well: the next one lists them
                self._listed = False
                raise
        now = time.monotonic()
        again = {robot for robot in self._changed if robot in self._lines}
        self._changed = {robot: until for robot, until in self._changed.items() if until > now}
        again |= {line.id for line in self._lines.values() if line.state is None}
        states = await self._states(sorted(again))
        if not states:
            return
        newest = await self._store.read(_newest_repairs, tuple(states))
        for robot, state in states.items():
            if robot in self._lines:
                self._lines[robot] = line_of(state, newest.get(robot))

    async def _list(self) -> None:
        """Read which robots there are."""
        paging: Paging | None = Paging(limit=1000)
        there: dict[str, Line] = {}
        while paging is not None:
            page = await self._store.read(robots.page, paging)
            for stored in page.items:
                config = stored.config
                known = self._lines.get(stored.id)
                if known is None or (known.model, known.policy) != (config["model"], config.get("policy")):
                    policy = str(config.get("policy", "approve"))
                    known = Line(stored.id, str(config["model"]), policy, None)
                there[stored.id] = known
            paging = Paging(page.next, 1000) if page.next is not None else None
        self._lines = there

    async def _states(self, wanted: Sequence[str]) -> dict[str, Robot]:
        """Return the robots as memory has them; what must be read is read for a while."""
        until = time.monotonic() + LOOK_S
        found = {}
        for robot in wanted:
            state = self._memory.states.get(robot)
            if (state is None or state.stale) and time.monotonic() > until:
                self._changed.setdefault(robot, 0.0)
                continue
            try:
                found[robot] = await self._memory.robot(robot)
            except RobomendError:  # deleted meanwhile, or its model is: the list shows it as not read
                continue
        return found


def _newest_repairs(view: View, wanted: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the newest repair of each robot that has one, with the steps of those that run."""
    found = {}
    for robot, repair in repairs.newest(view, wanted).items():
        steps = repairs.steps(view, repair.id) if repair.state == RepairState.RUNNING else ()
        found[robot] = repair_json(repair, steps)
    return found


def line_of(robot: Robot, repair: dict[str, Any] | None) -> Line:
    """Return a robot's line."""
    state, unknown = health_of(robot)
    finding, more = _finding(robot)
    if not finding and unknown:
        finding = f"not known: {listed([str(atom) for atom in unknown])}"
    headline = of_robot(robot, repair)
    waits, person = waits_for(repair, healthy=state.healthy, policy=robot.config.policy)
    current = robot.current
    return Line(
        robot.id,
        robot.stored.model or "",
        robot.config.policy,
        state,
        finding,
        more,
        waits,
        person or headline.person,
        None if current is None else current.time_ns,
        headline,
    )


def _finding(robot: Robot) -> tuple[str, int]:
    """Return the leading diagnosis, or why there is none, and how many others there are."""
    current = robot.current
    if current is None:
        return "", 0
    if current.result is None:
        return str((current.fault or {}).get("detail", "no diagnosis")), 0
    found = current.result["diagnoses"]
    if current.healthy or not found:
        return "", 0
    return listed(found[0]["bad"]), (current.result.get("count") or len(found)) - 1
