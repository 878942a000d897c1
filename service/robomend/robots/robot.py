"""What the service holds of one robot in memory: OBS, the diagnosis, and who waits for either.

A cache of the store, keyed by revision. A batch is applied here first and written then; writes of one robot
may be under way side by side, since the store commits them in the order of the calls. When one fails, or
another instance was faster, what is held is `stale` and is read again before its next use.

What happens to a robot is what its methods are called; the tables of states.py say what follows from what,
and nobody assigns a state from outside.
"""

from __future__ import annotations

import asyncio
import time
from array import array
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from itertools import chain
from typing import NamedTuple

from robomend.entry import Entry
from robomend.model.clauses import Assertion
from robomend.model.components import Function
from robomend.model.functions import all_of, taken_away
from robomend.model.loops import wait_for_themselves
from robomend.model.system import System, variant
from robomend.model.vocabulary import ACTIVE, TRENDS
from robomend.observations.obs import Belief, Obs, Retracted, consequences
from robomend.planning.configurations import Decision, FunctionState, Keeper, KnownState
from robomend.robots.batches import Update, Words
from robomend.robots.clock import AHEAD_NS, CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.diagnoser import Current
from robomend.robots.sight import Sight
from robomend.store import records
from robomend.store.records import Json
from robomend.transitions import after
from robomend_client.literals import Atom, Literal

# --- waiting for a number to grow: how long polls and the repair loop wait for OBS and diagnoses.


class Turnstile:
    """A number that only grows, and those who wait for it. Belongs to one event loop."""

    __slots__ = ("_waiters", "value")

    def __init__(self, value: int = 0) -> None:
        self.value = value
        self._waiters: set[asyncio.Future[None]] = set()

    @property
    def awaited(self) -> bool:
        """Whether anybody waits."""
        return bool(self._waiters)

    def advance(self, value: int) -> None:
        """Let everyone through who waits for this or less."""
        if value > self.value:
            self.value = value
            self.wake()

    def wake(self) -> None:
        """Let everyone look again."""
        if self._waiters:
            for waiter in self._waiters:
                if not waiter.done():
                    waiter.set_result(None)
            self._waiters.clear()

    async def beyond(self, value: int, timeout_s: float) -> int:
        """Return the number once it is above `value`, or whatever it is after the time-out or a wake."""
        if self.value > value:
            return self.value
        waiter = asyncio.get_running_loop().create_future()
        self._waiters.add(waiter)
        try:
            async with asyncio.timeout(timeout_s):
                await waiter
        except TimeoutError:
            pass
        finally:
            self._waiters.discard(waiter)
        return self.value


# --- the states of a robot in memory, and how each comes from the one before.
#
# Two things go on side by side: what is held may grow stale and is read again, and a diagnosis may be under
# way. Only Robot changes either.


class Held(StrEnum):
    """How what is held stands to the store."""

    UNREAD = "unread"
    FRESH = "fresh"  # as the store has it, or ahead of it by the writes under way
    STALE = "stale"  # read again before its next use
    GONE = "gone"  # deleted; whoever still holds it lets go


class HeldTrigger(StrEnum):
    """What happens to what is held."""

    READ = "read from the store"
    ACCEPTED = "a batch is taken in, its write begins"
    KEPT = "a write is on disk"
    NOT_KEPT = "a write failed, or was of a batch that is there already"
    CHANGED = "changed by another instance, configured, or given a new model"
    DELETED = "deleted"


HELD: dict[tuple[Held, HeldTrigger], Held] = {
    (Held.UNREAD, HeldTrigger.READ): Held.FRESH,
    (Held.FRESH, HeldTrigger.READ): Held.FRESH,
    (Held.FRESH, HeldTrigger.ACCEPTED): Held.FRESH,
    (Held.FRESH, HeldTrigger.KEPT): Held.FRESH,
    (Held.FRESH, HeldTrigger.NOT_KEPT): Held.STALE,
    (Held.FRESH, HeldTrigger.CHANGED): Held.STALE,
    (Held.FRESH, HeldTrigger.DELETED): Held.GONE,
    (Held.STALE, HeldTrigger.READ): Held.FRESH,
    (Held.STALE, HeldTrigger.ACCEPTED): Held.STALE,  # the store will refuse it, and it is tried again
    (Held.STALE, HeldTrigger.KEPT): Held.STALE,
    (Held.STALE, HeldTrigger.NOT_KEPT): Held.STALE,
    (Held.STALE, HeldTrigger.CHANGED): Held.STALE,
    (Held.STALE, HeldTrigger.DELETED): Held.GONE,
    (Held.GONE, HeldTrigger.ACCEPTED): Held.GONE,  # by who still holds it; the store refuses it
    (Held.GONE, HeldTrigger.KEPT): Held.GONE,
    (Held.GONE, HeldTrigger.NOT_KEPT): Held.GONE,
    (Held.GONE, HeldTrigger.CHANGED): Held.GONE,
}


class Search(StrEnum):
    """Whether a diagnosis is under way: one at a time, and one pending."""

    IDLE = "idle"
    UNDER_WAY = "under-way"
    PENDING = "pending"  # one is under way, and one more comes after it


class SearchTrigger(StrEnum):
    """What happens to a diagnosis under way."""

    WOKEN = "something changed"
    BEGAN = "OBS is read"
    CAME = "the diagnosis came"
    GAVE_UP = "it failed, or was cancelled"


SEARCH: dict[tuple[Search, SearchTrigger], Search] = {
    (Search.IDLE, SearchTrigger.WOKEN): Search.UNDER_WAY,
    (Search.UNDER_WAY, SearchTrigger.WOKEN): Search.PENDING,
    (Search.PENDING, SearchTrigger.WOKEN): Search.PENDING,
    (Search.UNDER_WAY, SearchTrigger.BEGAN): Search.UNDER_WAY,
    (Search.PENDING, SearchTrigger.BEGAN): Search.UNDER_WAY,
    (Search.UNDER_WAY, SearchTrigger.CAME): Search.IDLE,
    (Search.PENDING, SearchTrigger.CAME): Search.UNDER_WAY,
    (Search.UNDER_WAY, SearchTrigger.GAVE_UP): Search.IDLE,
    (Search.PENDING, SearchTrigger.GAVE_UP): Search.IDLE,
}


# --- which circles of topics (robomend.model.loops) were up on a robot, and the system description with them.
#
# Held in memory. After a restart of the service it is read off OBS, and off the last diagnosis: where that
# rests on a circle's clause, the circle was up.


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


class Measured:
    """How what was reported with a number went of late, for people; none of it is on disk.

    The store keeps what changes: that a rate falls from 10 to 9 Hz and is good all the same is nowhere else.
    """

    __slots__ = ("_courses",)

    NEWEST, MOST = 60, 200
    """Reports of each that are kept, and atoms of which any are."""

    def __init__(self) -> None:
        self._courses: dict[tuple[Atom, str], array[float]] = {}  # time, value, held: flat, as it is small

    def hear(self, entries: Iterable[Entry], now_ns: int) -> None:
        """Take note of what was measured."""
        for entry in entries:
            value = None if entry.reading is None else entry.reading.value
            if value is None or isinstance(value, str):
                continue
            course = self._courses.get((entry.atom, entry.source))
            if course is None:
                if len(self._courses) >= self.MOST:
                    continue
                course = self._courses[entry.atom, entry.source] = array("d")
            course.extend((now_ns, value, entry.positive))
            del course[: -3 * self.NEWEST]

    def course(self, atom: Atom, source: str) -> list[tuple[float, float, bool]]:
        """Return when it was reported (ns), what was measured, and whether it held; the oldest first."""
        flat = self._courses.get((atom, source), ())
        return [(flat[at], flat[at + 1], bool(flat[at + 2])) for at in range(0, len(flat), 3)]


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


class Writing(NamedTuple):
    """A batch on its way to the disk."""

    generation: int  # of what was held when it began
    began: float  # perf_counter


NOTHING = Retracted([], [], [])


class Taken(NamedTuple):
    """What an update did to OBS: all that must survive a restart."""

    changed: Sequence[Entry]  # what is known differs, or is contradicted from now on
    renewed: Sequence[Entry]  # only a lifetime, a reading or another source's word does
    forgotten: Sequence[Atom]  # nothing is known of them


class Robot:
    """One robot in memory; see the module."""

    __slots__ = (
        "__weakref__",
        "_announced",
        "_changed_at",
        "_circles",
        "_generation",
        "_head",
        "_held",
        "_own",
        "_read_again",
        "_search",
        "_task",
        "_timers",
        "_waiting_since",
        "_words",
        "_worsened",
        "assertion_records",
        "changing",
        "config",
        "configuration",
        "current",
        "diagnosed",
        "id",
        "measured",
        "model",
        "obs",
        "observed",
        "sight",
        "stored",
        "system",
    )

    def __init__(
        self,
        stored: records.StoredRobot,
        model: records.StoredModel,
        system: System,
        read_again: Callable[[str], Awaitable[Robot]],
    ) -> None:
        """`read_again` calls `read` on the robot of this id, if it is stale. NotFound."""
        self._configure(stored, model, system)
        self.obs = Obs()
        self._circles = Circles()
        self.measured = Measured()
        self.sight = Sight(self)
        self.assertion_records: dict[str, records.StoredAssertion] = {}
        self.configuration: Decision | None = None  # the latest, where this instance owns the robot
        self.changing: frozenset[str] = frozenset()  # what the acts of a change take away that is under way
        self.observed = Turnstile()  # committed revisions
        self.diagnosed = Turnstile()  # publications and confirmations, counted
        self.current: Current | None = None
        self._read_again = read_again
        self._held = Held.UNREAD
        self._head = 0  # the revision after the writes that are under way
        self._worsened = 0  # the latest revision with which something was heard not to hold
        self._generation = 0  # grows with each reading, so that a late write notices
        self._search = Search.IDLE
        self._task: asyncio.Task[None] | None = None  # the diagnosis under way
        self._announced: Current | None = None  # the latest that is published or being written
        self._waiting_since: float | None = None  # perf_counter of the oldest change not diagnosed
        self._changed_at = 0.0  # perf_counter of the latest change
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._own: tuple[tuple[str, tuple[Assertion, ...], tuple[str, ...]], str, System] | None = None

    @property
    def stale(self) -> bool:
        """Whether the store may know more."""
        return self._held is Held.STALE

    @property
    def gone(self) -> bool:
        """Whether the robot is deleted."""
        return self._held is Held.GONE

    @property
    def head(self) -> int:
        """The revision after the writes that are under way."""
        return self._head

    @property
    def writing(self) -> bool:
        """Whether memory is ahead of the disk."""
        return self._head != self.observed.value

    @property
    def generation(self) -> int:
        """How often it was read from the store."""
        return self._generation

    @property
    def diagnosing(self) -> bool:
        """Whether a diagnosis is under way."""
        return self._search is not Search.IDLE

    # --- what the repair loop looks at (see sight.py)

    @property
    def revision(self) -> int:
        """The latest revision that is on disk."""
        return self.observed.value

    def interlocked(self) -> str | None:
        """Return why nothing may be sent to the robot now (`act_when` of its model), or None."""
        return None if self.system.act_when is None else self.system.act_when.why_not(self.sight.value)

    async def changed(self, revision: int, timeout_s: float) -> int:
        """Return the revision once it is above `revision`, or the present one after the time-out.

        What another instance took in is read from the store first.
        """
        await self.observed.beyond(revision, timeout_s)
        await self.refreshed()
        return self.revision

    async def refreshed(self) -> None:
        """Return when what is held is what the store had a moment ago. NotFound."""
        if self.stale:
            await self._read_again(self.id)

    def literals(self) -> tuple[Literal, ...]:
        """Return what is known now."""
        return self.obs.literals(CLOCK.now_ns())

    def not_judged(self) -> tuple[Atom, ...]:
        """Return what does not hold, as long as the present diagnosis does not know all of it."""
        current = self.current
        judged = current is not None and current.model_version == self.model.version
        if current is not None and judged and current.revision >= self._worsened:
            return ()
        fallen = (literal.atom for literal in self.literals() if not literal.positive)
        return tuple(sorted(atom for atom in fallen if atom.predicate != ACTIVE))

    def wait_for_themselves(self) -> tuple[Atom, ...]:
        """Return what does not hold and is blamed on nobody only as topics wait for each other, in a circle
        that was not seen up on this robot.
        """
        parts = self.system.parts
        if parts is None or not self.system.loops or self.current is None or not self.current.healthy:
            return ()
        bad, good = set[str](), set[str]()
        for literal in self.literals():
            if literal.atom.predicate == "ok":
                (good if literal.positive else bad).add(literal.atom.args[0])
        if bad.isdisjoint(topic for loop in self.system.loops for topic in loop.topics):
            return ()
        stopped = self.expected_stopped
        up = self._circles.up(self.system, self.obs, stopped)
        loops = (loop for loop in self.system.loops if loop.clause not in up)
        found = (topic for loop in loops for topic in wait_for_themselves(parts, loop, bad, good, stopped))
        return tuple(sorted(Atom("ok", (topic,)) for topic in found))

    @property
    def words(self) -> Words:
        """In which sentences about it are read."""
        return self._words

    # --- what the engine is asked

    def question(self, literals: Iterable[Literal] | None = None) -> tuple[str, System, frozenset[Literal]]:
        """Return version, system and literals for the engine; by default what is known now.

        Assertions join the system description, and the clauses of circles of topics that were up, and nodes
        that are meant to be stopped leave scheme 5. The version names the result: equal versions are equal
        clauses.
        """
        literals = self.obs.known_literals(CLOCK.now_ns()) if literals is None else frozenset(literals)
        assertions = tuple(self.obs.assertions.values())
        stopped = self.expected_stopped
        if self.system.loops:
            assertions += self._circles.up(self.system, self.obs, stopped)
        if not assertions and not stopped:
            return self.model.version, self.system, literals
        wanted = (self.model.version, assertions, stopped)
        if self._own is None or self._own[0] != wanted:
            version = variant(*wanted)
            self._own = (wanted, version, extended(self.system, version, assertions, stopped))
        _, version, system = self._own
        return version, system, literals

    # --- configurations

    @property
    def functions(self) -> Mapping[str, Function]:
        """What the robot does in one of several variants."""
        return {} if self.system.parts is None else self.system.parts.functions

    @property
    def expected_stopped(self) -> tuple[str, ...]:
        """The components that are meant to be stopped or off: as configured, less what the active variants
        need, and what their acts take away.
        """
        listed, parts = self.config.expected_stopped, self.system.parts
        if parts is None or not parts.functions:
            return listed
        now_ns, needed, away = CLOCK.now_ns(), set[str](), set(self.changing)
        for function in parts.functions.values():
            for name, one in function.variants.items():
                if self.obs.known(Atom(ACTIVE, (function.name, name)), now_ns):
                    needed |= all_of(one, parts)
                    away |= taken_away(one)
        kept = [name for name in listed if name not in needed]
        return (*kept, *sorted(away.difference(kept)))

    def decided(self, decision: Decision | None) -> None:
        """Its owner has decided which variants its functions are to work by."""
        self.configuration = decision

    def is_changed(self, components: Collection[str]) -> None:
        """The acts of a change touch these components from now on; none: they are over."""
        self.changing = frozenset(components)

    def known(self, left_off: Collection[str] = ()) -> KnownState:
        """Return what its configuration rests on now."""
        now_ns, obs = CLOCK.now_ns(), self.obs

        def measured(atom: Atom) -> float | None:
            names = TRENDS if atom.predicate in TRENDS else (atom.predicate,)
            held = (obs.get(Atom(name, atom.args)) for name in names)
            fresh = [one for one in held if one is not None and one.fresh(now_ns) and one.reading is not None]
            newest = max(fresh, key=lambda one: one.time_ns, default=None)
            return None if newest is None or newest.reading is None else newest.reading.number

        current = self.current
        judged = current is not None and current.model_version == self.model.version
        diagnoses = (current.bad_sets or ()) if current is not None and judged else ()
        return KnownState(
            lambda atom: obs.known(atom, now_ns), measured, [*map(frozenset, diagnoses)], left_off
        )

    def function_states(self) -> Mapping[str, FunctionState]:
        """Return how its functions stand now."""
        parts = self.system.parts
        if parts is None or not parts.functions:
            return {}
        found = Keeper().decide(parts, self.system.conditions, self.known(), CLOCK.now_ns())
        decided = {} if self.configuration is None else self.configuration.states
        states = {}
        for name, state in found.states.items():
            last = decided.get(name)
            if last is None or last.active != state.active or last.function is not state.function:
                states[name] = replace(state, target=state.active)
                continue
            aside = {variant: standing for variant, standing in last.standings.items() if standing.aside}
            standings = {**state.standings, **aside}
            held, waits = last.held, last.waits
            states[name] = replace(state, target=last.target, held=held, waits=waits, standings=standings)
        return states

    # --- OBS ⊕ o

    def apply(self, update: Update) -> Taken:
        """Take an update into OBS. ObservationError if that would grow too large."""
        only_late = self.sight.only_late(update.entries)
        changed = self.obs.update(update.entries) if update.entries else ()
        mortal = [e for e in update.entries if e.expires_ns is not None or e.reading is not None]
        renewed: dict[Atom, Entry] = {}
        new = {entry.atom for entry in changed} if mortal or self.obs.several else set()
        if mortal:
            for entry in chain.from_iterable(map(consequences, mortal)):
                if entry.atom not in new and (held := self.obs.get(entry.atom)) == entry:
                    renewed[entry.atom] = held
        for atom in self.obs.several_of(update.entries):
            if atom not in new and (held := self.obs.get(atom)) is not None:
                renewed[atom] = held
        for assertion, record in update.asserted:
            self.obs.add(assertion)
            self.assertion_records[assertion.name] = record
        for name in update.withdrawn:
            self.obs.withdraw(name)
            self.assertion_records.pop(name, None)
        left = NOTHING
        if update.retracted:
            left = self.obs.retract(update.retracted)
            touched = {*left.gone, *(entry.atom for entry in (*left.changed, *left.renewed))}
            changed = (*[entry for entry in changed if entry.atom not in touched], *left.changed)
            renewed = {atom: entry for atom, entry in renewed.items() if atom not in touched}
            renewed |= {entry.atom: entry for entry in left.renewed}
            self.sight.taken_back(left.gone)
        if self.system.loops:
            self._circles.hear(update.entries)
        if any(not entry.positive and entry.atom.predicate != ACTIVE for entry in changed):
            self._worsened = self._head + 1
        self.measured.hear(update.entries, CLOCK.now_ns())
        known = [entry for entry in changed if not entry.contradicted]
        self.sight.spoken(update.entries, known)
        self.sight.hear(update.entries, known, only_late)
        self.sight.start_ups.hear(known, self.system.parts, self.sight)
        return Taken(changed, tuple(renewed.values()), left.gone)

    # --- what happens to what is held

    def read(
        self,
        stored: records.StoredRobot,
        model: records.StoredModel,
        system: System,
        obs: records.StoredObs,
        assertions: Iterable[Assertion],
        diagnosis: records.StoredDiagnosis | None,
        took: Mapping[str, Iterable[records.StoredStart]],
    ) -> None:
        """It was read from the store: configuration, model, OBS, the diagnosis if it is a newer one, and how
        long starts took.
        """
        self._held = after(HELD, self._held, HeldTrigger.READ)
        self._configure(stored, model, system)
        self.obs = Obs(obs.entries, assertions, Belief(self.config.believe, self.config.bad_wins))
        newest_ns = max((entry.time_ns for entry in obs.entries), default=0)
        if newest_ns > CLOCK.now_ns() + AHEAD_NS:  # no client's clock may be so far ahead: ours went back
            CLOCK.no_earlier_than(newest_ns + AHEAD_NS)  # what was stamped since and comes now is newer
        self.assertion_records = {assertion.name: assertion for assertion in obs.assertions}
        self._circles.hear(obs.entries)
        self.sight.hear(obs.entries)
        self.sight.start_ups.recall(took, system.parts)
        self._head = self._worsened = obs.revision
        self._generation += 1
        self.observed.advance(obs.revision)
        if diagnosis is not None and (self.current is None or self.current.revision < diagnosis.revision):
            self.current = self._announced = Current.stored(diagnosis)
        if self.current is not None:
            self._circles.were_up(system, self.current.result)

    def _configure(self, stored: records.StoredRobot, model: records.StoredModel, system: System) -> None:
        self.stored, self.id = stored, stored.id
        self.config = RobotConfig.from_json(stored.id, stored.config)
        self.model = model
        self.system = system
        self._words = Words.of(model, system, self.config)

    def accepted(self) -> Writing:
        """A batch was applied, and its write begins."""
        self._held = after(HELD, self._held, HeldTrigger.ACCEPTED)
        self._head += 1
        return Writing(self._generation, time.perf_counter())

    def kept(self, writing: Writing, revision: int, *, repeated: bool) -> None:
        """A write is on disk; `repeated`: an earlier one was, of a request with the same key."""
        self.observed.advance(revision)
        self._changed_at = writing.began
        if repeated or writing.generation != self._generation:
            # What memory has is not what the store has, or is from before the write: read it again first.
            self._held = after(HELD, self._held, HeldTrigger.NOT_KEPT)
            self._announced = None
        else:
            self._held = after(HELD, self._held, HeldTrigger.KEPT)

    def half_applied(self) -> None:
        """A batch was refused in the middle: a part of it may be in OBS here."""
        self._held = after(HELD, self._held, HeldTrigger.NOT_KEPT)

    def not_kept(self) -> None:
        """A write failed, or nobody knows whether it did: memory is ahead of the disk."""
        self._held = after(HELD, self._held, HeldTrigger.NOT_KEPT)
        self._announced = None
        self.observed.wake()  # whoever waits for the write looks, and reads it anew

    def changed_elsewhere(self) -> None:
        """The store has what is not here: another instance's batch, a configuration, a model."""
        self._held = after(HELD, self._held, HeldTrigger.CHANGED)
        self.observed.wake()

    def deleted(self) -> None:
        """The robot is no more: whoever waits is let go, nothing wakes it again."""
        self._held = after(HELD, self._held, HeldTrigger.DELETED)
        self.cancel_timers()
        if self._task is not None:
            self._task.cancel()
        self.diagnosed.wake()
        self.observed.wake()

    # --- what happens to its diagnosis

    def woken(self, diagnose: Callable[[], asyncio.Task[None]], since: float | None = None) -> None:
        """Something changed, at `since` (perf_counter): diagnose, once more after a diagnosis under way."""
        if since is not None and self._waiting_since is None:
            self._waiting_since = since
        before, self._search = self._search, after(SEARCH, self._search, SearchTrigger.WOKEN)
        if before is Search.IDLE:
            self._task = diagnose()

    def quiet_at(self, quiet_s: float) -> float:
        """Return when OBS has been quiet for so long (perf_counter), if nothing changes until then."""
        return self._changed_at + quiet_s

    def diagnosis_began(self) -> float | None:
        """OBS is read for a diagnosis. Return since when a change has waited for it (perf_counter)."""
        self._search = after(SEARCH, self._search, SearchTrigger.BEGAN)
        since, self._waiting_since = self._waiting_since, None
        return since

    def diagnosis_came(self) -> None:
        """A diagnosis under way has come; what changed meanwhile is pending, and is diagnosed now."""
        self._search = after(SEARCH, self._search, SearchTrigger.CAME)

    def diagnosis_gave_up(self) -> None:
        """A diagnosis under way came to nothing."""
        self._search = after(SEARCH, self._search, SearchTrigger.GAVE_UP)

    def announces(self, current: Current) -> bool:
        """A diagnosis is about to be published. Return whether it is news, or confirms the last one."""
        if current.says_the_same_as(self._announced):
            return False
        self._announced = current
        return True

    def confirms(self, current: Current) -> bool:
        """Return whether a diagnosis says what was published last."""
        return current.says_the_same_as(self._announced)

    @property
    def found_ns(self) -> int | None:
        """Since when the diagnosis says what it says now; None: there is none."""
        if self.current is None:
            return None
        same = self._announced is not None and self.current.says_the_same_as(self._announced)
        return self._announced.time_ns if self._announced is not None and same else self.current.time_ns

    def has_announced(self, revision: int) -> bool:
        """Return whether the diagnosis that is announced here is of this revision."""
        return self._announced is not None and self._announced.revision == revision

    def not_announced(self) -> None:
        """What was about to be published was not: it is still news."""
        self._announced = None

    def is_diagnosed(self, current: Current) -> None:
        """A diagnosis was published, or confirmed."""
        if self.current is None or current.revision >= self.current.revision:
            self.current = current
        self.diagnosed.advance(self.diagnosed.value + 1)

    def diagnosed_elsewhere(self, revision: int, time_ns: int, data: records.Json) -> None:
        """A diagnosis was published: by another instance, unless it is the one that we have announced."""
        if self._announced is None or revision > self._announced.revision:
            self.current = self._announced = Current.published(revision, time_ns, data)
            self.diagnosed.advance(self.diagnosed.value + 1)

    def looked_up(self, current: Current) -> None:
        """Somebody asked for a diagnosis that is to be had at once; it is published later."""
        self.current = current

    # --- what wakes it later

    def wake_later(self, name: str, delay_s: float, wake: Callable[[], None]) -> None:
        """Call back later; a timer of this name that runs already is cancelled."""
        self.cancel_timer(name)
        if not self.gone:
            self._timers[name] = asyncio.get_running_loop().call_later(delay_s, wake)

    def cancel_timer(self, name: str) -> None:
        """Stop a timer, if it runs."""
        timer = self._timers.pop(name, None)
        if timer is not None:
            timer.cancel()

    def cancel_timers(self) -> None:
        """Stop whatever would wake this robot later."""
        for name in tuple(self._timers):
            self.cancel_timer(name)
