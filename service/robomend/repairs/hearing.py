"""Whether the observers of a robot have spoken: an automatic repair must not be blind."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from functools import partial

from robomend.observations.obs import consequences
from robomend.planning.influence import influenced
from robomend.planning.prediction import OBSERVED_FACTS, theory_of
from robomend.repairs.conclusions import Silent
from robomend.repairs.record import RepairRecord
from robomend.repairs.signals import Signals
from robomend.repairs.states import RepairTrigger
from robomend.robots.boards import SOURCE
from robomend.robots.robot import Robot
from robomend.robots.robots import Robots
from robomend.store import Store, View, observations
from robomend.store.records import Page, Paging, StoredBatch
from robomend_client.literals import Atom

LOOK_S = 0.25
"""How often a wait for OBS looks at the clock as well: what grows stale wakes nobody."""


class Hearing:
    """Which atoms of the robot's `observed` list OBS has, and after a crash, which were reported since."""

    def __init__(
        self,
        store: Store,
        robots: Robots,
        state: Robot,
        record: RepairRecord,
        signals: Signals,
        since: int | None,
    ) -> None:
        """`since`: after a crash, the revision of OBS up to which observations do not count; else None."""
        self.observed = state.sight.observed
        self._anew = since is not None  # what was reported before does not count, until all were heard
        self._store = store
        self._robots = robots
        self._state = state
        self._record = record
        self._signals = signals
        self._since = since or 0
        self._heard: set[Atom] = set()  # reported since then
        self._complete = False  # whether all were heard once, in this repair

    async def hear_all(self, *, explained: bool = False) -> bool:
        """Wait until OBS holds each literal that the observers will report; return whether we had to.

        A person who asked for the repair is not kept waiting; what is unknown then is assumed, and shown.

        Args:
            explained: what is unknown for the sake of what is blamed is not waited for.
        """
        asked = bool(self._record.data.get("asked")) and not self._anew
        deadline = self._deadline()
        told: list[str] = []
        while missing := await self.unheard(explained=explained):
            names = [str(atom) for atom in missing]
            if asked:
                return False
            if time.monotonic() >= deadline:
                raise Silent(
                    f"nobody reported {', '.join(names)} within {self._state.config.observed_timeout_s:g} s: "
                    "start the observers, or take them off the robot's `observed` list"
                )
            if names != told:
                told = names
                await self._record.update(RepairTrigger.UNHEARD, reason="for observers", waiting_for=names)
            await self._next_news()
        self._anew, self._complete = False, True
        return bool(told)

    async def look_at(self, atom: Atom, reason: str) -> None:
        """Wait until somebody tells of an atom that is cheaper to look at than to repair on suspicion."""
        name = str(atom)
        await self._record.update(
            RepairTrigger.LOOKS_FIRST, reason=reason, waiting_for=[name], probe={"atom": name}
        )
        deadline = self._deadline()
        while self._state.sight.value(atom) is None and time.monotonic() < deadline:
            await self._next_news()

    async def still_silent(self, atoms: Iterable[Atom], since: int) -> list[Atom]:
        """Return those of the configured atoms whose observer stays silent, since a revision of OBS."""
        atoms = list(atoms)
        deadline = self._deadline()
        while silent := await self._silent_since(atoms, since):
            if time.monotonic() >= deadline:
                return silent
            await self._next_news()
        return []

    def _deadline(self) -> float:
        return time.monotonic() + self._state.config.observed_timeout_s

    async def _next_news(self) -> None:
        await self._signals.unless_halted(self._state.changed(self._state.revision, LOOK_S))

    async def unheard(self, *, explained: bool = False) -> list[Atom]:
        """Return the configured atoms that are unknown or, after a crash, were not reported since.

        Args:
            explained: without what is unknown for the sake of what is blamed.
        """
        if self._anew:
            await self._hear_since()
        silent = {atom for atom in self.observed if not self._state.sight.reported(atom)}
        if silent:
            silent -= self._mute_with_suspects(silent, explained=explained)
        if self._anew:
            board = (await self._robots.board(self._state.id)) if self._state.config.board else None
            silent |= {
                atom
                for atom in self.observed - self._heard
                # A board says only what changed; its literals are fresh once it has spoken at all.
                if not (board is not None and board.told and self._source(atom) == SOURCE)
            }
        return sorted(silent)

    def _mute_with_suspects(self, silent: Collection[Atom], *, explained: bool) -> frozenset[Atom]:
        """Return what nobody can judge as it rests on what is suspected: two values match or not while both
        are there. Once all were heard it need not be said; before, who observes it has to say that there is
        nothing to see, or who observes the topic of such a value that the topic is bad.
        """
        state, parts = self._state, self._state.system.parts
        suspects = frozenset(name for bad in (state.current and state.current.bad_sets) or () for name in bad)
        mute = [
            atom
            for atom in silent
            if (self._complete and atom.predicate not in OBSERVED_FACTS)
            or (explained and (state.sight.nothing_to_see(atom) or self._without_values(atom)))
        ]
        if parts is None or not suspects or not mute:
            return frozenset()
        _, system, _ = state.question(())
        return influenced(parts, theory_of(system.cnf), suspects, mute)

    def _without_values(self, atom: Atom) -> bool:
        """Return whether an atom is about values of a topic that is reported bad."""
        parts = self._state.system.parts
        values = () if parts is None else [parts.values[name] for name in atom.args if name in parts.values]
        return any(self._state.sight.value(Atom("ok", (value.topic,))) is False for value in values)

    def _source(self, atom: Atom) -> str | None:
        entry = self._state.obs.get(atom)
        return None if entry is None else entry.source

    async def _silent_since(self, atoms: Iterable[Atom], since: int) -> list[Atom]:
        """Return those of the configured atoms whose observer has said nothing since a revision of OBS.

        An observer that speaks of other things is alive. A board's link knows when it is not.
        """
        asked = {atom: self._source(atom) for atom in atoms if atom in self.observed}
        asked = {atom: source for atom, source in asked.items() if source not in {None, SOURCE}}
        if not asked:
            return []
        spoke = {entry.source for batch in await self._batches_after(since) for entry in batch.entries}
        return sorted(atom for atom, source in asked.items() if source not in spoke)

    async def _hear_since(self) -> None:
        """Note what was reported since the crash, to any instance, also where it only said the same again.

        By revision, not by time: a robot's clock may be an hour off.
        """
        new = await self._batches_after(self._since)
        self._heard.update(atom for batch in new for atom in _atoms(batch))
        self._since = max([self._since, *(batch.revision for batch in new)])

    async def _batches_after(self, revision: int) -> list[StoredBatch]:
        found: list[StoredBatch] = []
        paging: Paging | None = Paging(limit=200)
        while paging is not None:
            page = await self._store.read(partial(_history, self._state.id, paging))
            new = [batch for batch in page.items if batch.revision > revision]
            found += new
            more = page.next is not None and len(new) == len(page.items)
            paging = Paging(page.next, 200) if more else None
        return found


def _history(robot: str, paging: Paging, view: View) -> Page[StoredBatch]:
    return observations.history(view, robot, paging)


def _atoms(batch: StoredBatch) -> set[Atom]:
    """Return the atoms that a batch says something of; a trend denies the other trends."""
    return {said.atom for entry in batch.entries for said in consequences(entry)}
