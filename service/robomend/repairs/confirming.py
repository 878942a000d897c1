"""What a repair's acts made uncertain, and the wait until somebody has seen how it is now.

    act answered ──► atoms that it influences ──► unconfirmed, `settle` to the agents
                                                        │
    healthy? ──► only if each of them was seen since ◄──┘ else wait: start-up, settling, what is on its way

The wait ends: then a person is told what nobody could confirm, or, where those who should have are known to
speak on change only, the repair says so of itself.

What a round is credited with: a symptom that came back after an act which influences it was sent, and stayed
for as long as its observers may need to see it again. What came back before, or without such an act, came
back by itself; and what may have, as something that it rests on was interrupted and is back without us, is
credited to nobody either.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Collection, Iterable
from datetime import UTC, datetime

from robomend.cycle import stands_no_more
from robomend.diagnosis.result import DiagnosisResult
from robomend.entry import Entry
from robomend.model.components import ComponentModel
from robomend.observations.pending import GUARD_NS
from robomend.planning.influence import influenced, needed
from robomend.planning.prediction import OBSERVED_FACTS, theory_of
from robomend.planning.quarantine import BEFORE_NS
from robomend.repairs.conclusions import Silent, named
from robomend.repairs.execution_values import StepReport
from robomend.repairs.hearing import LOOK_S
from robomend.repairs.record import RepairRecord
from robomend.repairs.signals import Signals
from robomend.repairs.states import RepairTrigger
from robomend.robots.clock import CLOCK
from robomend.robots.robot import Robot
from robomend.robots.sight import SLACK_NS, SLACK_S
from robomend.store.records import Json
from robomend_client.actions import REFUSED, UNREACHABLE, Action, ActionResult
from robomend_client.literals import Atom
from robomend_client.readings import Symptom

MOST_STAYS_S = 60.0
"""For what came back to stay, however slow its observers are."""

DID_NOT_ACT = frozenset({REFUSED, UNREACHABLE})

SOON_SEEN = frozenset({Symptom.SILENT, Symptom.ENDED})
"""What observers notice within their detection delay, should it come back."""


class Confirming:
    """Of one repair."""

    def __init__(
        self,
        state: Robot,
        record: RepairRecord,
        signals: Signals,
        observed: frozenset[Atom],
        newest: Callable[[], Awaitable[DiagnosisResult]],
        shows_s: Callable[..., float],
        start_up_s: Callable[[str], float],
    ) -> None:
        """
        Args:
            observed: what somebody should report.
            newest: returns the diagnosis of what is confirmed now.
            shows_s: actions, by name -> how long the effect of one of them may take to show.
            start_up_s: component -> how long it may need, once started, until it shows.
        """
        self._state = state
        self._record = record
        self._signals = signals
        self._observed = observed
        self._newest = newest
        self._shows_s = shows_s
        self._start_up_s = start_up_s
        self._acts_need_s = shows_s("power_up", "start_node")  # those of before this repair, too
        self._began_ns = CLOCK.now_ns()
        self._symptoms: dict[Atom, Entry] = {}  # of the present round
        self._good = frozenset[Atom]()  # what held when it began
        self._back: dict[Atom, int] = {}  # those that hold again, since when at first
        self._acted: dict[Atom, int] = {}  # what its acts influence -> when the first such act was sent

    def begins(self, entries: Iterable[Entry]) -> None:
        """A round begins; what does not hold of these are its symptoms."""
        known = {entry.atom: entry for entry in entries}
        self._good = frozenset(atom for atom, entry in known.items() if entry.positive)
        self._symptoms = {atom: entry for atom, entry in known.items() if not entry.positive}
        self._back, self._acted = {}, {}

    @property
    def symptoms(self) -> Collection[Entry]:
        """What did not hold when the round began."""
        return self._symptoms.values()

    def acted(self, action: Action, result: ActionResult, report: StepReport) -> Json | None:
        """Note what an act that has answered made uncertain; return what agents are to judge anew."""
        parts = self._state.system.parts
        if result.code in DID_NOT_ACT or parts is None:
            return None
        components = frozenset(parts.components)
        acted_on = components.intersection(
            [*action.parameters, *(arg for effect in report.step.effects for arg in effect.atom.args)]
        )
        known = {entry.atom for entry in self._state.obs.entries()} | self._observed
        atoms = self._influenced(parts, acted_on, known)
        facts = {atom for atom in atoms if atom.predicate in OBSERVED_FACTS}
        now_ns = CLOCK.now_ns()
        sent_ns, sight = report.sent_ns or now_ns, self._state.sight
        for atom in atoms:
            self._acted.setdefault(atom, sent_ns)
        n = sight.acted(facts, sent_ns, atoms - facts, now_ns)
        shows_s = self._shows_s(action.name)
        self._acts_need_s = max([self._acts_need_s, shows_s, *map(self._start_up_s, acted_on)])
        sight.start_ups.acted(action, sent_ns, now_ns + round(shows_s * 1e9))
        return {"n": n, "atoms": [str(atom) for atom in sorted(atoms)]}

    async def seen(self) -> None:
        """Wait until all is confirmed that acts made uncertain, or nobody can be expected to any more."""
        while self._left_s() > 0:
            await self._news()

    async def confirmed(self, result: DiagnosisResult) -> DiagnosisResult:
        """Return a diagnosis that is not healthy, or one that is, and that rests on what was seen.

        Silent: nobody could confirm it.
        """
        told = False
        while result.healthy and (left := self._state.sight.not_confirmed()):
            names = named(left)
            if max(self._left_s(), self._held_up_s(left)) <= 0:
                since_ns = max(self._state.sight.unconfirmed.acts[atom].from_ns for atom in left)
                since = datetime.fromtimestamp(since_ns / 1e9, UTC).strftime("%H:%M:%S")
                raise Silent(
                    f"nobody could confirm {names} since {since} UTC, when the last act had answered: "
                    "nothing else is wrong; look at the robot, and whether its observers still work"
                )
            if not told and max(self._left_s(), self._held_up_s(left)) > 1.0:
                told = True
                await self._record.update(
                    RepairTrigger.UNHEARD,
                    reason=f"until {names} is seen after the last act",
                    waiting_for=[str(atom) for atom in left],
                )
            await self._news()
            result = await self._newest()
        return result

    # --- what a round is credited with

    async def stays(self, bad: tuple[str, ...], result: DiagnosisResult) -> DiagnosisResult:
        """Return the diagnosis once the observers of what came back have had the time to see it fail again,
        or as soon as any of these is blamed again.
        """
        deadline = time.monotonic() + MOST_STAYS_S
        while stands_no_more(bad, result):
            left_s = min(self._unproven_s(bad), deadline - time.monotonic())
            if left_s <= 0:
                break
            revision = self._state.revision
            await self._signals.unless_halted(self._state.changed(revision, min(LOOK_S, max(0.01, left_s))))
            result = await self._newest()
        return result

    def by_itself(self, bad: Collection[str]) -> str | None:
        """Return why that these are not blamed any more is nothing that the round's acts have done; None: it
        is, or nobody can tell.
        """
        theirs = sorted(self._symptoms_of(bad))
        back = [atom for atom in theirs if self._state.sight.value(atom)]
        if theirs and not back:
            return f"{named(theirs)}: not seen to be back"
        why = [self._not_ours(atom, self._rose_ns(atom)) for atom in back]
        return why[0] if why and None not in why else None

    def undid(self) -> list[Atom]:
        """Return what held before the round and fails since its acts, though by the model they do not
        influence it: whatever came back by them, they have not helped.
        """
        if not self._acted:
            return []
        acted_ns = min(self._acted.values()) - BEFORE_NS
        entries = self._state.sight.entries()
        ours = self._good - self._acted.keys()
        fallen = (one for one in entries if not one.positive and not one.deaf and one.atom in ours)
        fallen = (one for one in fallen if one.atom.predicate in {"ok", *OBSERVED_FACTS})
        return sorted(one.atom for one in fallen if one.began_ns >= acted_ns)

    def _symptoms_of(self, bad: Collection[str]) -> frozenset[Atom]:
        """Return the round's symptoms that these components may have, or all where there is none of them."""
        parts = self._state.system.parts
        theirs = frozenset[Atom]() if parts is None else self._influenced(parts, bad, self._symptoms)
        return theirs or frozenset(self._symptoms)

    def _unproven_s(self, bad: Collection[str]) -> float:
        """Return how long until what came back would have been seen to fail again."""
        sight, now_ns = self._state.sight, CLOCK.now_ns()
        ends = []
        for atom in self._symptoms_of(bad):
            if (rose_ns := self._rose_ns(atom)) is not None:
                delays, reading = sight.delays(atom), self._symptoms[atom].reading
                soon = reading is not None and reading.symptom in SOON_SEEN
                again_ns = delays.detection_ns if soon else max(delays.detection_ns, delays.settling_ns)
                ends.append(rose_ns + again_ns)
        return (max(ends) + sight.on_its_way_ns() - now_ns) / 1e9 if ends else 0.0

    def _rose_ns(self, atom: Atom) -> int | None:
        """Return since when a symptom holds again; None: it does not, or nobody knows."""
        sight = self._state.sight
        value, rose_ns = sight.value(atom), sight.rose_ns(atom)
        if value is False:
            self._back.pop(atom, None)
        elif value and rose_ns is not None:
            self._back.setdefault(atom, rose_ns)
        return self._back.get(atom)

    def _not_ours(self, atom: Atom, rose_ns: int | None) -> str | None:
        sent_ns = self._acted.get(atom)
        if not self._acted:
            return f"{atom} is back, and of the last plan nothing was done"
        if sent_ns is None:
            return f"{atom} is back, and nothing that was done influences it"
        if rose_ns is None:
            return None
        if rose_ns < sent_ns - GUARD_NS:
            return f"{atom} was back before anything was done that influences it"
        delays = self._state.sight.delays(atom)
        within_ns = round(self._acts_need_s * 1e9) + max(delays.detection_ns, delays.settling_ns)
        began = self._symptoms[atom]
        onset_ns = began.began_ns
        for other, what, fell_ns, back_ns in sorted(self._state.sight.interruptions(began.source)):
            acted_ns = self._acted.get(other)
            ours = acted_ns is not None and back_ns >= acted_ns - GUARD_NS
            # It may have been told of the one a little before it was of the other.
            soon = back_ns - SLACK_NS <= rose_ns <= back_ns + within_ns
            meanwhile = onset_ns <= back_ns and fell_ns <= rose_ns
            if other != atom and not ours and soon and meanwhile and self._rests(atom, other):
                return f"{atom} is back, as {what} for {max(0, back_ns - fell_ns) / 1e9:.1f} s"
        return None

    def _rests(self, atom: Atom, other: Atom) -> bool:
        """Return whether an atom may not hold because another does not."""
        parts = self._state.system.parts
        if parts is None:
            return False
        topics = set[str]().union(*needed(parts, atom.args).values())
        components = frozenset(parts.components).intersection(other.args)
        return bool(topics.intersection(other.args)) or bool(
            components and self._influenced(parts, components, [atom])
        )

    def _influenced(
        self, parts: ComponentModel, components: Collection[str], known: Iterable[Atom]
    ) -> frozenset[Atom]:
        _, system, _ = self._state.question(())
        return influenced(parts, theory_of(system.cnf), frozenset(components), known)

    def _left_s(self) -> float:
        """Return how long what is not confirmed may still take."""
        acts, now_ns = self._state.sight.unconfirmed.acts, CLOCK.now_ns()
        left = self._state.sight.not_confirmed()
        # What an earlier repair left unconfirmed gets its time in this one, too.
        began = {atom: max(acts[atom].from_ns, self._began_ns) for atom in left}
        ends = [began[a] + self._state.sight.delays(a).settling_ns - now_ns for a in left]
        return max(ends) / 1e9 + self._acts_need_s + SLACK_S if ends else 0.0

    def _held_up_s(self, left: Collection[Atom]) -> float:
        """Return how long those who are configured to report these may still be held up: nothing else is
        wrong, and an agent of a busy computer cannot judge for a while.
        """
        acts, now_ns = self._state.sight.unconfirmed.acts, CLOCK.now_ns()
        began = [max(acts[atom].from_ns, self._began_ns) for atom in left if atom in self._observed]
        waits_s = self._state.config.observed_timeout_s + SLACK_S
        return (max(began) - now_ns) / 1e9 + waits_s if began else 0.0

    async def _news(self) -> None:
        left_s = min(LOOK_S, self._left_s()) if self._left_s() > 0 else LOOK_S
        left_s = max(0.01, left_s)
        await self._signals.unless_halted(self._state.changed(self._state.revision, left_s))
