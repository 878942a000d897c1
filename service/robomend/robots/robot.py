"""What the service holds of one robot in memory: OBS, the diagnosis, and who waits for either.

A cache of the store, keyed by revision. A batch is applied here first and written then; writes of one robot
may be under way side by side, since the store commits them in the order of the calls. When one fails, or
another instance was faster, the state is `stale` and is read again before its next use.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from robomend.model.clauses import Assertion
from robomend.model.system import System, variant
from robomend.observations.obs import Obs, Observed, consequences
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.diagnoser import Diagnosed
from robomend.robots.turnstile import Turnstile
from robomend.store import records
from robomend_client.literals import Atom, Literal

AHEAD_NS = 60 * 10**9
"""How far in the future a client's clock may be: an entry from the future outlives everything older."""


@dataclass(frozen=True, slots=True)
class Current:
    """The diagnosis that was published last."""

    revision: int
    model_version: str
    time_ns: int
    result: dict[str, Any] | None  # JSON
    fault: dict[str, Any] | None  # why there is none
    answer: Diagnosed | None  # None: made by another instance, or before a restart
    expected_stopped: tuple[str, ...] = ()  # what the diagnosis does not expect to run


@dataclass(frozen=True, slots=True)
class Changes:
    """What a batch changes in OBS, as the store keeps it."""

    accepted: tuple[records.Entry, ...]
    changed: tuple[records.Entry, ...]
    kept: tuple[records.Entry, ...]  # changed, or with a renewed lifetime
    forgotten: tuple[Atom, ...]
    asserted: tuple[records.StoredAssertion, ...]
    withdrawn: tuple[str, ...]

    @property
    def text(self) -> list[str]:
        """The changed literals as sentences."""
        return [str(Literal(entry.atom, entry.positive)) for entry in self.changed]


class Robot:
    """One robot in memory; see the module."""

    __slots__ = (
        "__weakref__",
        "_own",
        "again",
        "announced",
        "assertion_records",
        "changed_at",
        "config",
        "current",
        "diagnosed",
        "generation",
        "gone",
        "head",
        "model",
        "obs",
        "observed",
        "stale",
        "stored",
        "system",
        "task",
        "timers",
        "waiting_since",
    )

    def __init__(self, stored: records.StoredRobot, model: records.StoredModel, system: System) -> None:
        self.stored = stored
        self.config = RobotConfig.from_json(stored.id, stored.config)
        self.model = model
        self.system = system
        self.obs = Obs()
        self.assertion_records: dict[str, records.StoredAssertion] = {}
        self.observed = Turnstile()  # committed revisions
        self.diagnosed = Turnstile()  # publications and confirmations, counted
        self.head = 0  # the revision after the writes that are under way
        self.generation = 0  # grows with each reload, so that a late write notices
        self.stale = False
        self.current: Current | None = None
        self.announced: Current | None = None  # the latest that is published or being written
        self.task: asyncio.Task[None] | None = None  # the diagnosis in flight
        self.again = False  # … and the one pending
        self.waiting_since: float | None = None  # perf_counter of the oldest change not diagnosed
        self.changed_at = 0.0  # perf_counter of the latest change
        self.gone = False  # deleted; whoever still holds this lets go
        self.timers: dict[str, asyncio.TimerHandle] = {}
        self._own: tuple[tuple[str, tuple[Assertion, ...], tuple[str, ...]], str, System] | None = None

    @property
    def id(self) -> str:
        return self.stored.id

    # --- what the repair loop reads (its Sight)

    @property
    def revision(self) -> int:
        """The latest revision that is on disk."""
        return self.observed.value

    def value(self, atom: Atom) -> bool | None:
        """Return whether the atom is observed to hold; None: unknown, or stale."""
        return self.obs.known(atom, CLOCK.now_ns())

    async def changed(self, revision: int, timeout_s: float) -> int:
        """Return the revision once it is above `revision`, or the present one after the time-out."""
        return await self.observed.beyond(revision, timeout_s)

    def literals(self) -> tuple[Literal, ...]:
        """Return what is known now."""
        return self.obs.literals(CLOCK.now_ns())

    # --- what the engine is asked

    def question(self) -> tuple[str, System, frozenset[Literal]]:
        """Return version, system and literals for the engine.

        Assertions join the system description, and nodes that are meant to be stopped leave scheme 5. The
        version names the result: equal versions are equal clauses.
        """
        literals = frozenset(self.literals())
        assertions = tuple(self.obs.assertions.values())
        stopped = self.config.expected_stopped
        if not assertions and not stopped:
            return self.model.version, self.system, literals
        wanted = (self.model.version, assertions, stopped)
        if self._own is None or self._own[0] != wanted:
            self._own = (wanted, variant(*wanted), self.system.extended(assertions, stopped))
        _, version, system = self._own
        return version, system, literals

    # --- OBS ⊕ o

    def apply(
        self,
        observed: Sequence[Observed],
        *,
        asserted: Iterable[tuple[Assertion, records.StoredAssertion]] = (),
        withdrawn: Sequence[str] = (),
        forgotten: Sequence[Atom] = (),
    ) -> Changes:
        """Take a batch into OBS and return what the store must keep.
        ObservationError if OBS would grow too large.
        """
        changed = self.obs.update(observed) if observed else ()
        kept = {entry.literal.atom: entry for entry in changed}
        for given in observed:
            if given.expires_ns is not None:  # a renewed lifetime must survive a restart as well
                for entry in consequences(given):
                    if self.obs.get(entry.literal.atom) == entry:
                        kept[entry.literal.atom] = entry
        for assertion, record in asserted:
            self.obs.add(assertion)
            self.assertion_records[assertion.name] = record
        for name in withdrawn:
            self.obs.withdraw(name)
            self.assertion_records.pop(name, None)
        if forgotten:
            self.obs.forget(forgotten)
        return Changes(
            accepted=tuple(map(_entry, observed)),
            changed=tuple(map(_entry, changed)),
            kept=tuple(map(_entry, kept.values())),
            forgotten=tuple(forgotten),
            asserted=tuple(record for _, record in asserted),
            withdrawn=tuple(withdrawn),
        )

    def reload(self, stored: records.StoredObs, assertions: Iterable[Assertion]) -> None:
        """Replace OBS by what the store has."""
        entries = (
            Observed(Literal(entry.atom, entry.positive), entry.source, entry.time_ns, entry.expires_ns)
            for entry in stored.entries
        )
        self.obs = Obs(entries, assertions)
        newest_ns = max((entry.time_ns for entry in stored.entries), default=0)
        if newest_ns > CLOCK.now_ns() + AHEAD_NS:  # no client's clock may be so far ahead: ours went back
            CLOCK.no_earlier_than(newest_ns)
        self.assertion_records = {assertion.name: assertion for assertion in stored.assertions}
        self.head = stored.revision
        self.generation += 1
        self.stale = False
        self.observed.advance(stored.revision)

    def cancel_timers(self) -> None:
        """Stop whatever would wake this robot later."""
        for timer in self.timers.values():
            timer.cancel()
        self.timers.clear()


def _entry(observed: Observed) -> records.Entry:
    literal = observed.literal
    return records.Entry(
        literal.atom, literal.positive, observed.source, observed.time_ns, observed.expires_ns
    )
