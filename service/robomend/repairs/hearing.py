"""Whether the observers of a robot have spoken: an automatic repair must not be blind."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from robomend.observations.language import parse
from robomend.observations.obs import Observed, consequences
from robomend.robots.boards import SOURCE
from robomend.robots.robot import Robot
from robomend.robots.robots import Robots
from robomend.store import Store, View, observations
from robomend.store.records import Page, Paging, StoredBatch
from robomend_client.literals import Atom, Literal


class LiveSight:
    """OBS of a robot in memory; another instance's observations are read from the store as they come."""

    def __init__(self, robots: Robots, state: Robot) -> None:
        self._robots = robots
        self._state = state

    @property
    def revision(self) -> int:
        return self._state.revision

    def value(self, atom: Atom) -> bool | None:
        return self._state.value(atom)

    async def changed(self, revision: int, timeout_s: float) -> int:
        await self._state.changed(revision, timeout_s)
        if self._state.stale:
            await self._robots.robot(self._state.id)
        return self._state.revision


class Hearing:
    """Which atoms of the robot's `observed` list OBS has, and after a crash, which were reported since."""

    def __init__(self, store: Store, robots: Robots, state: Robot, since: int | None) -> None:
        """`since`: after a crash, the revision of OBS up to which observations do not count; else None."""
        self.anew = since is not None
        """Whether what was reported before does not count; until all were heard."""
        self.observed = frozenset(
            literal.atom
            for sentence in state.config.observed
            for literal in parse(sentence, state.system.vocabulary)
        )
        self._store = store
        self._robots = robots
        self._state = state
        self._since = since or 0
        self._heard: set[Atom] = set()  # reported since then

    async def unheard(self) -> list[Atom]:
        """Return the configured atoms that are unknown or, after a crash, were not reported since."""
        if self.anew:
            await self._hear_since()
        silent = {atom for atom in self.observed if self._state.value(atom) is None}
        if self.anew:
            board = (await self._robots.board(self._state.id)) if self._state.config.board else None
            silent |= {
                atom
                for atom in self.observed - self._heard
                # A board says only what changed; its literals are fresh once it has spoken at all.
                if not (board is not None and board.told and self._source(atom) == SOURCE)
            }
        return sorted(silent)

    def _source(self, atom: Atom) -> str | None:
        entry = self._state.obs.get(atom)
        return None if entry is None else entry.source

    async def silent_since(self, atoms: Iterable[Atom], since: int) -> list[Atom]:
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
    return {
        said.literal.atom
        for entry in batch.entries
        for said in consequences(Observed(Literal(entry.atom, entry.positive), entry.source, entry.time_ns))
    }
