"""No act without need: a repair waits while a verdict that is about to come could change what it does.

    diagnosis ──► the act ──► pending verdicts? ── none ──► act
                                   │
                 each of them otherwise, all bad, all unknown: the same act? ── yes ──► act
                                   │ no
                        wait until one comes, or its observer had its time ──► from the start

Whether it could change the act is asked of the engine and the planner themselves. The wait is bounded: by
what observers declare, and where symptoms go on beginning, by MOST_S.

Power is not cut first of all for a symptom that is younger than what it takes to come back by itself from a
moment without power: to boot, to start, and for its observers to say so.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping
from dataclasses import replace
from functools import partial

from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.entry import Entry
from robomend.model.components import ComponentModel
from robomend.observations.pending import SLACK_NS, first_fallen, newest_onset, pending, returning, starting
from robomend.planning.choice import Choice
from robomend.planning.cures import power_cuts
from robomend.planning.influence import influenced, needed, published, touched
from robomend.planning.plan import Plan
from robomend.planning.prediction import OBSERVED_FACTS, theory_of
from robomend.repairs.record import RepairRecord
from robomend.repairs.signals import Signals
from robomend.repairs.states import RepairTrigger
from robomend.robots.clock import CLOCK
from robomend.robots.robot import Robot
from robomend_client.literals import Atom, Literal

MOST_FLIPS = 32
"""Pending verdicts that are tried one by one; with more, one waits for some of them first."""

MOST_S = 10.0
"""Of waiting in one round, however many symptoms begin anew, beyond the slowest verdict's time."""

LONGEST_S = 600.0
"""Of that time itself: what boots or starts may be slow."""

CUT_OFF_NS = 5 * 10**9
"""For who is cut off to be heard again, once it should have been: a link that dropped is back by then, or not
soon. Meanwhile it is not known whether there is anything to repair."""

AT_ONCE_S = 0.35
"""A wait that is shorter than to find out whether it is needed."""

TELL_S = 1.0
"""Waits that take longer are written into the record."""

MEANWHILE_S = 8.0
"""Waits that take longer, as for a device that boots, are time for a repair of what is blamed in any case."""

Diagnose = Callable[[Iterable[Literal]], Awaitable[DiagnosisResult]]
Choose = Callable[[DiagnosisResult, Iterable[Literal]], Awaitable[Choice]]


class Calm:
    """Of one repair."""

    def __init__(
        self,
        state: Robot,
        record: RepairRecord,
        signals: Signals,
        observed: frozenset[Atom],
        newest: Callable[[], Awaitable[DiagnosisResult]],
        diagnose: Diagnose,
        choose: Choose,
        start_up_s: Callable[[str], float],
    ) -> None:
        """
        Args:
            observed: what somebody should report.
            newest: returns the diagnosis of what is confirmed now.
            diagnose: returns the diagnosis of given literals.
            choose: returns what would be done about a diagnosis, these literals given.
            start_up_s: returns how long a component that was started may need until it shows.
        """
        self._state = state
        self._record = record
        self._signals = signals
        self._observed = observed
        self._newest = newest
        self._diagnose = diagnose
        self._choose = choose
        self._start_up_s = start_up_s
        self._anyhow = frozenset[str]()  # what is blamed whatever the verdicts are that were pending last

    async def settled(self, result: DiagnosisResult) -> DiagnosisResult:
        """Return the diagnosis once no pending verdict could change the first act; or of it what is blamed
        whatever they are, if it can be mended meanwhile.
        """
        began, told, longest_s = time.monotonic(), False, 0.0
        while not result.healthy:
            left = self._pending()
            slowest_s = max((end - CLOCK.now_ns() for end in left.values()), default=0) / 1e9
            longest_s = min(max(longest_s, slowest_s), LONGEST_S)
            if not left or time.monotonic() - began > MOST_S + longest_s:
                break
            if slowest_s > AT_ONCE_S:
                asked_of = self._state.revision
                if not await self._may_change(result, left):
                    if self._state.revision == asked_of:
                        break
                    result = await self._newest()  # something else came while it was asked
                    continue
                sure = await self._sure(result) if slowest_s > MEANWHILE_S else None
                if sure is not None and self._state.revision == asked_of:
                    return sure
            if not told and max(slowest_s, time.monotonic() - began) > TELL_S:
                told = True
                names = [str(atom) for atom in sorted(left)]
                await self._record.update(
                    RepairTrigger.UNHEARD, reason="for verdicts that are about to come", waiting_for=names
                )
            wait_s = min(left.values()) - CLOCK.now_ns()
            await self._signals.unless_halted(
                self._state.changed(self._state.revision, max(0.01, wait_s / 1e9))
            )
            result = await self._newest()
        return result

    async def waits_with_cut(self, choice: Choice, result: DiagnosisResult) -> bool:
        """Wait where a plan begins with a cut of power although what it is for may still be back by itself;
        return whether it was waited for.
        """
        end_ns, asked_of = self._may_be_back_ns(choice.plan), bad_sets(result)
        if (end_ns - CLOCK.now_ns()) / 1e9 > TELL_S:
            why = "whether it comes back by itself, before power is cut for it"
            await self._record.update(RepairTrigger.UNHEARD, reason=why, waiting_for=[])
        waited = False
        while bad_sets(result) == asked_of and (left_s := (end_ns - CLOCK.now_ns()) / 1e9) > 0:
            waited = True
            await self._signals.unless_halted(self._state.changed(self._state.revision, left_s))
            result = await self._newest()
        return waited

    def _may_be_back_ns(self, plan: Plan | None) -> int:
        """Return until when what a plan cuts the power of may be back by itself, if it had been without power
        for a moment; 0: it does not begin with a cut, or something was done for it already, in vain.
        """
        parts, written = self._state.system.parts, self._record.data
        if plan is None or parts is None or written.get("rounds") or written.get("asked"):
            return 0
        sight, names = self._state.sight, touched(parts, power_cuts(plan))
        symptoms = [e for e in sight.entries() if not e.positive and not names.isdisjoint(e.atom.args)]
        if not symptoms or not names:
            return 0
        began_ns = min(e.began_ns for e in symptoms)
        shows_ns = max(sight.delays(e.atom).settling_ns for e in symptoms) + SLACK_NS
        return began_ns + round(max(map(self._start_up_s, power_cuts(plan))) * 1e9) + shows_ns

    def _pending(self) -> dict[Atom, int]:
        """Return the verdicts that are about to come, each with until when."""
        state, now_ns = self._state, CLOCK.now_ns()
        entries = {entry.atom: entry for entry in state.obs.entries() if entry.fresh(now_ns)}
        unconfirmed = frozenset(state.sight.not_confirmed())
        expected = set(state.expected_stopped)
        said = [e for a, e in entries.items() if a not in unconfirmed]
        symptoms = [e for e in said if not e.positive and not expected.intersection(e.atom.args)]
        parts = state.system.parts
        onset_ns = newest_onset(symptoms if parts is None else first_fallen(symptoms, partial(needed, parts)))
        if onset_ns is None:
            return {}
        bad = {entry.atom for entry in symptoms}
        other = (self._observed | entries.keys()) - bad
        found = pending(
            other,
            onset_ns,
            lambda atom: state.sight.delays(atom).detection_ns,
            now_ns,
            state.sight.on_its_way_ns(),
        )
        found |= self._unseen(unconfirmed, now_ns)
        found |= self._late(now_ns)
        turns = ((atom, state.sight.turns_ns(atom) + state.sight.on_its_way_ns()) for atom in bad)
        found |= {atom: end_ns for atom, end_ns in turns if end_ns > now_ns}
        found |= state.obs.doubted(now_ns)
        for atom, due_ns in state.sight.not_heard_since_onset().items():
            if due_ns + CUT_OFF_NS > now_ns:
                found[atom] = max(due_ns + CUT_OFF_NS, found.get(atom, 0))
        if parts is not None:
            facts = [e for e in said if e.positive and e.atom.predicate in OBSERVED_FACTS]
            began = {e.atom: began_ns for e in facts if (began_ns := self._began_ns(e)) is not None}
            until = {a: since + max(self._may_take_ns(a.args[0], since)) for a, since in began.items()}
            young = {atom: since for atom, since in began.items() if until[atom] > now_ns}
            since = {atom.args[0]: since_ns for atom, since_ns in young.items()}
            found |= starting(
                [entry for entry in said if entry.positive or entry.atom in bad],
                since,
                lambda name: self._may_take_ns(name, since[name]),
                lambda name: touched(parts, [name]),
                lambda name: published(parts, [name]),
                state.sight.good_ns,
                now_ns,
                {atom.args[0] for atom in young if not state.sight.seen_off(atom)},
            )
            risen = self._risen(parts, said)
            back = returning(
                symptoms,
                risen,
                partial(needed, parts),
                lambda atom: state.sight.delays(atom).settling_ns,
                now_ns,
            )
            for supply in {name for each in parts.hardware.values() for name in each.fed_by}:
                fed = published(parts, [supply])  # what is back of it may be the first
                first_ns = max((risen[topic] for topic in fed & risen.keys()), default=0)
                for entry in (e for e in symptoms if not fed.isdisjoint(e.atom.args)):
                    end_ns = first_ns + state.sight.delays(entry.atom).settling_ns + SLACK_NS
                    if end_ns > now_ns and entry.began_ns < first_ns:
                        back[entry.atom] = max(end_ns, back.get(entry.atom, 0))
            # Who is heard again after it was cut off may itself hear again what it says is bad.
            for entry in symptoms:
                again_ns = state.sight.heard_again_ns(entry.source) or 0
                end_ns = again_ns + state.sight.delays(entry.atom).settling_ns + SLACK_NS
                if end_ns > now_ns and entry.began_ns < again_ns:
                    back[entry.atom] = max(end_ns, back.get(entry.atom, 0))
            found |= {atom: max(end, found.get(atom, 0)) for atom, end in back.items()}
        return found

    def _began_ns(self, entry: Entry) -> int | None:
        """Return since when something is on, or runs, by who says so or by when it was heard to change.

        What was only late with saying it again has not begun anew, though nobody looked for a moment.
        """
        sight = self._state.sight
        rose_ns = sight.rose_ns(entry.atom)
        if entry.onset_ns is None:
            return rose_ns if sight.seen_off(entry.atom) else None
        return entry.onset_ns if rose_ns is None else min(entry.onset_ns, rose_ns)

    def _risen(self, parts: ComponentModel, said: Collection[Entry]) -> dict[str, int]:
        """Return topics that are good, or may be by who publishes them, with since when.

        Of who was cut off and is heard again all comes anew, be it good all along.
        """
        sight, found = self._state.sight, dict[str, int]()
        for entry in said:
            names = entry.atom.args if entry.atom.predicate == "ok" else published(parts, entry.atom.args)
            rose_ns = sight.rose_ns(entry.atom) if entry.atom.predicate == "ok" else None
            since_ns = max(rose_ns or 0, sight.heard_again_ns(entry.source) or 0)
            if entry.positive and since_ns:
                found |= {name: max(since_ns, found.get(name, 0)) for name in names}
        return found

    def _unseen(self, unconfirmed: Collection[Atom], now_ns: int) -> dict[Atom, int]:
        """Return what nobody has seen since an act that may have changed it, while observers have time."""
        sight = self._state.sight
        slack_ns = sight.on_its_way_ns()
        ends = {a: sight.unconfirmed.acts[a].from_ns + sight.delays(a).settling_ns for a in unconfirmed}
        return {atom: end + slack_ns for atom, end in ends.items() if end + slack_ns > now_ns}

    def _late(self, now_ns: int) -> dict[Atom, int]:
        """Return what lapsed a moment ago, while it may only be late: without it others are suspected."""
        sight = self._state.sight
        left = ((atom, sight.may_be_late_s((atom,))) for atom in sight.lapsed())
        return {atom: now_ns + round(late_s * 1e9) for atom, late_s in left if late_s > 0}

    def _may_take_ns(self, name: str, began_ns: int) -> tuple[int, int]:
        """Return how long what began then may need until its own topics show it, and what rests on them."""
        parts, sight = self._state.system.parts, self._state.sight
        usual_ns = round(self._start_up_s(name) * 1e9) + SLACK_NS
        if parts is None or name not in parts.nodes:
            return usual_ns, usual_ns
        node = parts.nodes[name]
        known_ns = sight.start_ups.after_our_start_ns(node, began_ns, parts, sight)
        if known_ns is not None:  # what rests on it is judged anew after that
            names = touched(parts, [name]) - published(parts, [name])
            bad = (e.atom for e in self._state.obs.entries() if not e.positive and names & set(e.atom.args))
            anew_ns = max((sight.delays(atom).settling_ns for atom in bad), default=0)
            return known_ns, known_ns + (anew_ns + SLACK_NS if anew_ns else 0)
        if "effect_timeout_s" not in self._state.config.actions.get("start_node", {}):
            usual_ns = max(usual_ns, sight.start_ups.at_boot_ns(node, began_ns, parts, sight))
        return usual_ns, usual_ns

    async def _may_change(self, result: DiagnosisResult, left: Collection[Atom]) -> bool:
        """Return whether one of the pending verdicts could change what is done first, where it is due to the
        same fault.
        """
        self._anyhow = frozenset()
        if not result.diagnoses:  # none found in time: there is no act yet
            return True
        known = {literal.atom: literal for literal in self._state.sight.vouched()}
        rest = [literal for atom, literal in known.items() if atom not in set(left)]
        unknown = await self._diagnose(rest)
        left = self._theirs(unknown, left, known)
        if len(left) > MOST_FLIPS:
            return True
        now = bad_sets(result)
        common = self._anyhow = frozenset[str].intersection(*map(frozenset, now))
        others: dict[frozenset[tuple[str, ...]], tuple[DiagnosisResult, list[Literal]]] = {}
        for literals in (rest, *_variants(known, sorted(left))):
            other = unknown if literals is rest else await self._diagnose(literals)
            sets = bad_sets(other)
            self._anyhow = self._anyhow.intersection(*map(frozenset, sets or {()}))
            if other.healthy:
                return True
            repaired_anyhow = len(now) == 1 and bool(sets) and all(common <= set(bad) for bad in sets)
            another = bool(sets) and least(sets) > least(now)  # a fault of its own, which begins just now
            if sets != now and not repaired_anyhow and not another:
                others.setdefault(sets, (other, literals))
        if not others:
            return False
        acts = first_acts(await self._choose(result, known.values()))
        if not acts:
            return True  # to give up is an act, too
        for other, literals in others.values():
            if not acts <= first_acts(await self._choose(other, literals)):
                return True
        return False

    async def _sure(self, result: DiagnosisResult) -> DiagnosisResult | None:
        """Return the diagnosis of what is blamed whatever the pending verdicts are, if that can be mended
        and was not tried yet.
        """
        bad = tuple(name for name in result.components if name in self._anyhow)
        tried = [one["diagnosis"]["bad"] for one in self._record.data.get("rounds", ())]
        if not bad or list(bad) in tried:
            return None
        sure = replace(result, diagnoses=(Diagnosis(bad),), elapsed_s=0.0)
        return sure if first_acts(await self._choose(sure, self._state.sight.vouched())) else None

    def _theirs(
        self, unknown: DiagnosisResult, left: Collection[Atom], known: Mapping[Atom, Literal]
    ) -> Collection[Atom]:
        """Return those of the verdicts that may come out otherwise by the faults which are suspected while
        they are unknown: all others take a fault of their own. What is bad may be good in any case.
        """
        parts, suspects = self._state.system.parts, frozenset[str]().union(*bad_sets(unknown))
        if parts is None or not suspects:
            return left
        _, system, _ = self._state.question(())
        theirs = influenced(parts, theory_of(system.cnf), suspects, left)
        return [atom for atom in left if atom in theirs or (atom in known and not known[atom].positive)]


def bad_sets(result: DiagnosisResult) -> frozenset[tuple[str, ...]]:
    """Return what each diagnosis blames."""
    return frozenset(diagnosis.bad for diagnosis in result.diagnoses)


def least(sets: Iterable[tuple[str, ...]]) -> int:
    """Return how many faults it takes at least."""
    return min(map(len, sets))


def first_acts(choice: Choice) -> frozenset[str]:
    """Return the steps that are done first."""
    return frozenset() if choice.plan is None else frozenset(str(s) for s in choice.plan.steps if not s.after)


def _variants(known: dict[Atom, Literal], left: list[Atom]) -> Iterable[list[Literal]]:
    """Return what else may be observed soon: all of it bad, each alone otherwise."""
    rest = [literal for atom, literal in known.items() if atom not in set(left)]
    yield [*rest, *(Literal(atom, False) for atom in left)]
    for atom in left:
        held = known.get(atom)
        others = [literal for other, literal in known.items() if other != atom]
        yield [*others, Literal(atom, held is not None and not held.positive)]
