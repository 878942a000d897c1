"""OBS as a repair looks at it: only what is fresh, and rests on nothing from before an act that may have
changed it (robomend.observations.pending).

Also what that takes: the clocks of those who report, and how fast the robot's agents say that they observe.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Iterator, Set
from dataclasses import replace
from functools import partial
from math import inf
from typing import TYPE_CHECKING

from robomend.entry import Entry
from robomend.errors import ObservationError
from robomend.model.components import Hardware
from robomend.model.vocabulary import ACTIVE, Vocabulary
from robomend.observations.language import parse
from robomend.observations.obs import MAX_ATOMS, consequences
from robomend.observations.pending import (
    GUARD_NS,
    Act,
    Confirmed,
    LastHeard,
    Unconfirmed,
    first_fallen,
    newest_onset,
)
from robomend.planning.influence import needed
from robomend.planning.prediction import OBSERVED_FACTS
from robomend.robots.clock import CLOCK
from robomend.robots.dating import Dating, SourceClocks, Twins
from robomend.robots.declared import DeclaredAgents, Delays
from robomend.robots.start_ups import StartUps
from robomend_client.literals import Atom, Literal
from robomend_client.observers import BOARD
from robomend_client.readings import Symptom

if TYPE_CHECKING:
    from robomend.robots.robot import Robot

NOTHING: frozenset[Atom] = frozenset()

SLACK_S = 0.3
"""For what is on its way, beyond what observers declare."""

SLACK_NS = round(SLACK_S * 1e9)

LEAST_SLACK_NS = 100_000_000
"""For what is on its way where all that came lately came equally fast."""

LATER_NS = 2 * GUARD_NS
"""Evidence so much later than the first one is not in doubt for the sake of clocks."""


def _symptom(entry: Entry) -> bool:
    """Whether something does not hold that should; which variant of a function is active is no symptom."""
    return not entry.positive and entry.atom.predicate != ACTIVE


class Sight:
    """Of one robot in memory (robomend.repairs.execution_values.FreshObs)."""

    __slots__ = (
        "_bad",
        "_clocks",
        "_fell",
        "_heard",
        "_listed",
        "_off",
        "_powerless",
        "_risen",
        "_robot",
        "_rose",
        "_settle",
        "_taken_back",
        "declared",
        "power_back",
        "repeated_ns",
        "start_ups",
        "twins",
        "unconfirmed",
    )

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._clocks = SourceClocks(robot.id)
        self._heard = LastHeard()
        self._settle = 0  # the latest settle number; by the clock, so that none comes twice after a crash
        self._rose: dict[Atom, tuple[int, ...]] = {}  # what holds -> since when: first, and a bit later
        self._fell: dict[Atom, tuple[int, ...]] = {}  # what holds no more -> the same, of when it did
        self._risen: set[Atom] = set()  # those of them of which the latter is not known yet
        self._bad: dict[Atom, int] = {}  # what did not hold -> since when, the last time
        self._off: set[Atom] = set()  # what was heard to be off, or not to run, since we hear of the robot
        self._taken_back: dict[Atom, int] = {}  # what is said to be unknown -> since when
        self._powerless: set[str] = set()  # devices that were last heard to be off
        self.power_back: dict[str, int] = {}  # device -> when it was heard to be on, after it was off
        self.repeated_ns = 0  # when the board last said what it had said before
        self._listed: tuple[tuple[str, ...], Vocabulary, frozenset[Atom]] | None = None
        self.declared = DeclaredAgents()
        self.start_ups = StartUps()
        self.twins = Twins()
        self.unconfirmed = Unconfirmed()

    # --- what is seen

    @property
    def revision(self) -> int:
        """The latest revision of OBS that is on disk."""
        return self._robot.revision

    async def changed(self, revision: int, timeout_s: float) -> int:
        """Return the revision once it is above `revision`, or the present one after the time-out."""
        return await self._robot.changed(revision, timeout_s)

    def value(self, atom: Atom) -> bool | None:
        """Return whether the atom is observed to hold; None: unknown, stale, or not seen since an act."""
        now_ns = CLOCK.now_ns()
        if atom in self.unconfirmed and self._confirmed(atom, now_ns) is Confirmed.NOT:
            return None
        return self._robot.obs.known(atom, now_ns)

    def reported(self, atom: Atom) -> bool:
        """Return whether somebody reports the atom, with either sign, be it from before an act."""
        return self._robot.obs.known(atom, CLOCK.now_ns()) is not None

    def literals(self) -> tuple[Literal, ...]:
        """Return what is known now and rests on nothing from before an act that may have changed it."""
        left = frozenset(self.not_confirmed())
        literals = self._robot.literals()
        return tuple(literal for literal in literals if literal.atom not in left) if left else literals

    def vouched(self) -> tuple[Literal, ...]:
        """Return `literals` without what those say who repeat themselves and were not heard since the newest
        symptom began, although they had the time.
        """
        now_ns = CLOCK.now_ns()
        silent = frozenset(atom for atom, due_ns in self.not_heard_since_onset().items() if due_ns <= now_ns)
        return tuple(literal for literal in self.literals() if literal.atom not in silent)

    def not_heard_since_onset(self) -> dict[Atom, int]:
        """Return what holds by those who repeat themselves and were not heard since the newest symptom began,
        or since their observers could have noticed: until when they may still be about to be.
        """
        robot = self._robot
        entries, expected = self.entries(), set(robot.expected_stopped)
        symptoms = [e for e in entries if _symptom(e) and not expected.intersection(e.atom.args)]
        parts = robot.system.parts
        onset_ns = newest_onset(symptoms if parts is None else first_fallen(symptoms, partial(needed, parts)))
        if onset_ns is None:
            return {}
        found: dict[Atom, int] = {}
        tellers, left = {BOARD, *(entry.source for entry in symptoms)}, frozenset(self.not_confirmed())
        for entry in robot.obs.entries():  # also what has lapsed meanwhile
            if not entry.positive or entry.source in tellers or entry.atom in left:
                continue
            if entry.expires_ns is not None and entry.expires_ns < onset_ns:
                continue
            noticed_ns = onset_ns + self.delays(entry.atom).detection_ns
            if self._heard.silent_since(entry.source, noticed_ns):
                usual_ns = self._heard.usual_ns(entry.source) or 0
                found[entry.atom] = noticed_ns + 2 * usual_ns + self.on_its_way_ns()
        return found

    def entries(self) -> tuple[Entry, ...]:
        """Return the entries of what is known now, and rests on nothing from before an act."""
        now_ns, left = CLOCK.now_ns(), frozenset(self.not_confirmed())
        entries = self._robot.obs.entries()
        return tuple(entry for entry in entries if entry.atom not in left and entry.fresh(now_ns))

    def lapsed(self) -> tuple[Atom, ...]:
        """Return what was reported with a lifetime that is over, as far as the model's rules speak of it."""
        robot = self._robot
        if not robot.obs.mortal or len(robot.literals()) == len(robot.obs):
            return ()
        now_ns, used = CLOCK.now_ns(), robot.system.cnf.atom_variable
        return tuple(e.atom for e in robot.obs.entries() if not e.fresh(now_ns) and e.atom in used)

    def lapsed_bad(self) -> tuple[Atom, ...]:
        """Return what of that was last said not to hold: nobody has said that it is well."""
        held = ((atom, self._robot.obs.get(atom)) for atom in self.lapsed())
        return tuple(atom for atom, entry in held if entry is not None and not entry.positive)

    def symptoms(self) -> frozenset[Atom]:
        """Return what was last said not to hold, be it known now or lapsed."""
        return frozenset(entry.atom for entry in self._robot.obs.entries() if _symptom(entry))

    def may_be_late_s(self, unknown: Iterable[Atom]) -> float:
        """Return in how many seconds each of these that lapsed was silent for one more of its lifetimes.

        0: they were, or never had one.
        """
        now_ns, least_s = CLOCK.now_ns(), 0.0
        for atom in unknown:
            entry = self._robot.obs.get(atom)
            if entry is not None and not entry.fresh(now_ns):
                least_s = max(least_s, (self._clocks.late_until_ns(entry) - now_ns) / 1e9)
        return least_s

    def kinds_of_symptoms(self) -> dict[Atom, Symptom]:
        """Return in which way what does not hold now is bad, where its observer says that."""
        return {
            entry.atom: entry.reading.symptom
            for entry in self.entries()
            if not entry.positive and entry.reading is not None and entry.reading.symptom is not None
        }

    def onsets(self) -> dict[Atom, int]:
        """Return what does not hold now, with its last good sample where that is known."""
        now_ns, entries = CLOCK.now_ns(), self._robot.obs.entries()
        return {
            entry.atom: entry.onset_ns
            for entry in entries
            if not entry.positive and entry.onset_ns is not None and entry.fresh(now_ns)
        }

    def from_outside(self) -> frozenset[Literal]:
        """Return what is known now of topics that nobody in the model publishes."""
        outside = self._robot.system.outside
        known = ((atom, self.value(atom)) for atom in outside)
        return frozenset(Literal(atom, value) for atom, value in known if value is not None)

    @property
    def observed(self) -> frozenset[Atom]:
        """What somebody should report: the robot's `observed` list."""
        robot = self._robot
        listed, vocabulary = robot.config.observed, robot.system.vocabulary
        if not listed:
            return NOTHING
        if self._listed is None or self._listed[0] != listed or self._listed[1] is not vocabulary:
            atoms: set[Atom] = set()
            for sentence in listed:
                with contextlib.suppress(ObservationError):  # the model has no such word any more
                    atoms.update(literal.atom for literal in parse(sentence, vocabulary))
            self._listed = (listed, vocabulary, frozenset(atoms))
        return self._listed[2]

    # --- what is not confirmed

    def not_confirmed(self) -> tuple[Atom, ...]:
        """Return what was influenced by acts and is not seen since."""
        return self._those(Confirmed.NOT)

    def confirmed_by_silence(self) -> tuple[Atom, ...]:
        """Return what was influenced by acts, and of which there is no news although there would be some."""
        return self._those(Confirmed.BY_SILENCE)

    def not_seen_since_acts(self) -> tuple[Atom, ...]:
        """Return what was influenced by acts and was not reported anew since, whoever would have been to."""
        if not self.unconfirmed:
            return ()
        obs = self._robot.obs
        return tuple(sorted(atom for atom in self.unconfirmed.acts if obs.get(atom) is not None))

    def settling_s(self, atom: Atom) -> float:
        """Return how long it may take until the atom is confirmed; 0 if it is."""
        if atom not in self.unconfirmed or self.value(atom) is not None:
            return 0.0
        return self.delays(atom).settling_ns / 1e9 + SLACK_S

    def may_take_s(self, missing: Collection[Literal], sent_ns: int, answered_ns: int) -> float:
        """Return in how many seconds one of these, awaited of that act, will have had more than its time."""
        parts = self._robot.system.parts
        if parts is None:
            return inf
        return self.start_ups.may_take_s(missing, sent_ns, answered_ns, parts, self)

    def due_s(self, missing: Collection[Literal], usual_s: float) -> float:
        """Return in how many seconds the last of these may be due, by how long what they rest on takes to
        boot and to start; below 0: nothing says that any is due later than now.
        """
        parts = self._robot.system.parts
        return -inf if parts is None else self.start_ups.due_s(missing, usual_s, parts, self)

    def denied_s(self, missing: Collection[Literal], sent_ns: int, answered_ns: int) -> float:
        """Return in how many seconds the observer of one of these, which says since that act that it is not
        so, will have settled; inf: none says so, or what it rests on has begun since.
        """
        now_ns = CLOCK.now_ns()
        ends = [
            answered_ns + self.delays(literal.atom).settling_ns + self.on_its_way_ns()
            for literal in missing
            if self._denied(literal, answered_ns, now_ns) and not self._begun_since(literal.atom, sent_ns)
        ]
        return (min(ends) - now_ns) / 1e9 if ends else inf

    def _denied(self, literal: Literal, answered_ns: int, now_ns: int) -> bool:
        """Whether the opposite is observed, on evidence from after the answer only."""
        atom, entry = literal.atom, self._robot.obs.get(literal.atom)
        if entry is None or atom.predicate in OBSERVED_FACTS or atom in self.unconfirmed:
            return False
        anew = entry.settled is not None and entry.settled >= self._settle
        young = entry.since_ns is not None and entry.since_ns > answered_ns
        return self._robot.obs.known(atom, now_ns) is (not literal.positive) and (anew or young)

    def _begun_since(self, atom: Atom, time_ns: int) -> bool:
        """Whether something that the atom may rest on was switched on, or began to run, after that."""
        parts = self._robot.system.parts
        if parts is None:
            return False
        needs = needed(parts, atom.args)
        topics = {*atom.args, *(topic for name in atom.args for topic in needs.get(name, ()))}
        publishers = self.start_ups.publishers(parts)
        nodes = [node for topic in sorted(topics) for node in publishers.get(topic, ())]
        names = {name for node in nodes for name in (node.name, *node.drives)}
        began = (Atom(parts.parts[name].state, (name,)) for name in names)
        return any((self.rose_ns(each) or 0) > time_ns for each in began)

    def _those(self, how: Confirmed) -> tuple[Atom, ...]:
        if not self.unconfirmed:
            return ()
        now_ns = CLOCK.now_ns()
        acts = self.unconfirmed.acts
        return tuple(sorted(atom for atom in acts if self._confirmed(atom, now_ns) is how))

    def _confirmed(self, atom: Atom, now_ns: int) -> Confirmed:
        entry = self._robot.obs.get(atom)
        if entry is None:
            return Confirmed.NOT
        return self.unconfirmed.how(entry, self.delays(atom).detection_ns + SLACK_NS, now_ns)

    # --- what happens

    def acted(self, facts: Set[Atom], sent_ns: int, rest: Collection[Atom], answer_ns: int) -> int:
        """An act has answered. Return the settle number with which it is confirmed.

        Args:
            facts: what it brings about itself (on, running).
            rest: what else it influences.
        """
        self._settle = max(self._settle + 1, answer_ns // 1_000_000)
        held = {atom: self._robot.obs.get(atom) for atom in facts}
        young = {a for a, entry in held.items() if entry and entry.since_ns and entry.since_ns > sent_ns}
        # What the board says is dated by the clock that dated the sending.
        ours = {atom for atom, entry in held.items() if entry and entry.source == BOARD}
        for atoms, from_ns in ((facts - ours, sent_ns), (ours, sent_ns - GUARD_NS)):
            self.unconfirmed.touch(atoms - young, Act(self._settle, from_ns))
        self.unconfirmed.touch((atom for atom in rest if atom not in held), Act(self._settle, answer_ns))
        return self._settle

    def seen_off(self, atom: Atom) -> bool:
        """Return whether something was ever heard to be off, or not to run: if so, its beginning was seen."""
        return atom in self._off

    def rose_ns(self, atom: Atom) -> int | None:
        """Return since when something that holds is known to, as it began to; None: nobody knows."""
        times = self._rose.get(atom)
        return None if times is None else times[0]

    def fell_ns(self, atom: Atom) -> int | None:
        """Return until when something held that does not any more; None: it does, or nobody knows."""
        return self._bad.get(atom) if atom in self._fell else None

    def interruptions(self, reporter: str) -> Iterator[tuple[Atom, str, int, int]]:
        """Yield what did not hold, or was not heard of, and holds now: in words, from when and until when.

        Args:
            reporter: it was not interrupted itself, however long it was silent.
        """
        now_ns = CLOCK.now_ns()
        for atom, fell_ns in self._bad.items():
            rose = self._rose.get(atom)
            if rose is not None and rose[0] >= fell_ns and self._robot.obs.known(atom, now_ns):
                yield atom, f"{atom} is, which did not hold", fell_ns, rose[0]
        for entry in self._robot.obs.entries():
            silent = self._heard.interruption(entry.source)
            if silent is not None and entry.source != reporter and entry.positive and entry.fresh(now_ns):
                yield entry.atom, f"{entry.source} is, which was not heard", *silent

    def heard_again_ns(self, source: str) -> int | None:
        """Return since when a source is heard again that was silent for unusually long, the last time."""
        silent = self._heard.interruption(source)
        return None if silent is None else silent[1]

    def good_ns(self, entry: Entry) -> tuple[int, ...]:
        """Return times since when something that holds is known to: from when it was news, and from now; of
        what does not hold any more, since when it did the last time.
        """
        if not entry.positive:
            return self._fell.get(entry.atom, ())
        now_ns = () if entry.since_ns is None else (entry.since_ns,)
        return self._rose.get(entry.atom, ()) + now_ns

    def only_late(self, reported: Iterable[Entry]) -> frozenset[Atom]:
        """Return what of that holds and did when it lapsed a moment ago, by OBS before it takes that in: who
        says it is rarer heard than its lifetime, or late, and would have said that it did not hold meanwhile.
        """
        if not self._robot.obs.mortal:
            return frozenset()
        now_ns, found = CLOCK.now_ns(), set[Atom]()
        for entry in reported:
            was = self._robot.obs.get(entry.atom)
            same = was is not None and was.literal == entry.literal and was.source == entry.source
            if was is not None and same and entry.positive and not was.fresh(now_ns):
                found |= {entry.atom} if now_ns < self._clocks.late_until_ns(was) else set()
        return frozenset(found)

    def hear(
        self,
        reported: Iterable[Entry],
        changed: Iterable[Entry] = (),
        only_late: Collection[Atom] = frozenset(),
    ) -> None:
        """Take note of what was reported, as far as OBS has taken it in; `changed` is what was news, of which
        `only_late` held all the time.
        """
        if self._risen:
            for entry in reported:
                if entry.atom in self._risen and entry.positive and entry.since_ns is not None:
                    (first_ns,) = self._rose[entry.atom]
                    if entry.since_ns > first_ns + LATER_NS:
                        self._rose[entry.atom] = (first_ns, entry.since_ns)
                        self._risen.discard(entry.atom)
        if len(self._rose) + len(self._fell) > MAX_ATOMS:  # of those that nobody speaks of any more
            self._rose.clear()
            self._fell.clear()
            self._risen.clear()
        if len(self._off) > MAX_ATOMS:
            self._off.clear()
        if len(self._bad) > MAX_ATOMS:
            self._bad.clear()
            self._powerless.clear()
            self.power_back.clear()
        if self._taken_back:
            for entry in reported:
                self._taken_back.pop(entry.atom, None)
        for entry in changed:
            atom, positive = entry.literal
            if not positive:
                self._bad[atom] = entry.began_ns
            if not positive and atom.predicate in OBSERVED_FACTS:
                self._off.add(atom)
            if atom.predicate == Hardware.state and len(atom.args) == 1:
                self._switched(atom.args[0], entry)
            if positive and atom in only_late:
                continue
            held = self._rose.pop(atom, None)
            if positive:
                self._fell.pop(atom, None)
            elif held is not None:
                self._fell[atom] = held
            if positive and entry.since_ns is not None:
                self._rose[atom] = (entry.since_ns,)
                self._risen.add(atom)
            else:
                self._risen.discard(atom)
        if self.unconfirmed:
            said = (entry for given in reported for entry in consequences(given))
            self.unconfirmed.hear(entry for entry in said if self._robot.obs.get(entry.atom) == entry)

    def spoken(self, reported: Iterable[Entry], changed: Iterable[Entry]) -> None:
        """Take note of who has spoken just now, whether it was news or not."""
        new, now_ns = frozenset(entry.atom for entry in changed), CLOCK.now_ns()
        spoke: dict[str, tuple[int, bool, int]] = {}
        for entry in reported:
            said_ns, again, lives_ns = spoke.get(entry.source, (0, False, 0))
            spoke[entry.source] = (
                max(said_ns, entry.time_ns),
                again or entry.atom not in new,
                max(lives_ns, (entry.expires_ns or entry.time_ns) - entry.time_ns),
            )
        for source, (said_ns, again, lives_ns) in spoke.items():  # it may have been on its way for long
            at_ns = min(now_ns, said_ns + self._clocks.lives_on_ns(source))
            self._heard.hear(source, at_ns, again=again, lives_ns=lives_ns, arrived_ns=now_ns)

    def taken_back(self, atoms: Collection[Atom]) -> None:
        """Take note of what those who reported it say to be unknown from now on."""
        if len(self._taken_back) + len(atoms) > MAX_ATOMS:
            self._taken_back.clear()
        now_ns = CLOCK.now_ns()
        for atom in atoms:
            self._taken_back.setdefault(atom, now_ns)

    def nothing_to_see(self, atom: Atom) -> bool:
        """Return whether who reports it has said that it is unknown, and had the time to judge it anew."""
        since_ns = self._taken_back.get(atom)
        if since_ns is None or self.reported(atom):
            return False
        return CLOCK.now_ns() > since_ns + self.delays(atom).settling_ns + self.on_its_way_ns()

    def _switched(self, device: str, entry: Entry) -> None:
        """Take note of a device's power, which was heard to have changed."""
        if not entry.positive:
            self._powerless.add(device)
        elif device in self._powerless:
            self._powerless.discard(device)
            self.power_back[device] = entry.since_ns or entry.time_ns

    def said_again(self, literals: Collection[Literal], time_ns: int) -> None:
        """Take note of literals that a source says anew, at this time, and that OBS holds as they are."""
        self.repeated_ns = time_ns
        held = (self._robot.obs.get(literal.atom) for literal in literals if literal.atom in self.unconfirmed)
        same = (entry for entry in held if entry is not None and entry.literal in literals)
        if self.unconfirmed.hear(replace(entry, since_ns=time_ns) for entry in same):
            self._robot.observed.wake()

    # --- how fast, and since when

    def looked_ns(self, atom: Atom) -> int:
        """Return until when its observers have looked, by what its newest report rests on; 0: nobody knows.

        What turned later than that might not be told yet.
        """
        entry = self._robot.obs.get(atom)
        if entry is None or entry.since_ns is None:
            return 0
        delays = self.declared.delays(atom, Delays(0, 0))
        if not delays.detection_ns:
            return entry.since_ns  # which is already as much less than its report as such an observer needs
        silent_until_ns = entry.since_ns + delays.detection_ns
        told_ns = entry.time_ns + max(0, self._clocks.lives_on_ns(entry.source))
        if told_ns <= silent_until_ns:
            return silent_until_ns
        return entry.since_ns if self.turns_ns(atom) else told_ns

    def turns_ns(self, atom: Atom) -> int:
        """Return until when what does not hold may turn, as its observer hears it again; 0: it does not.

        Of silence `since` is the present less what was waited for, as much as detection takes. Once there are
        samples again it stands still, until the observer has settled: what is heard again is not known to be
        bad. What is bad for longer, or is said to be in another way, is so by its samples, as of the report.
        """
        entry, delays = self._robot.obs.get(atom), self.declared.delays(atom, Delays(0, 0))
        if entry is None or entry.since_ns is None or not delays.detection_ns:
            return 0
        if entry.reading is not None and entry.reading.symptom not in {None, Symptom.SILENT}:
            return 0
        heard_ns = entry.since_ns + delays.detection_ns
        told_ns = entry.time_ns + max(0, self._clocks.lives_on_ns(entry.source))
        return heard_ns + delays.settling_ns if heard_ns < told_ns < heard_ns + delays.settling_ns else 0

    def turns_s(self, atom: Atom, acted_ns: int) -> float:
        """Return in how many seconds an observer that says that something does not hold cannot say otherwise
        any more, of what an act that answered then has brought back.
        """
        end_ns = max(acted_ns + self.delays(atom).settling_ns, self.turns_ns(atom)) + self.on_its_way_ns()
        return (end_ns - CLOCK.now_ns()) / 1e9

    def delays(self, atom: Atom) -> Delays:
        """Return how fast the atom's observers are."""
        usual_ns = 0 if atom.predicate in OBSERVED_FACTS else self._usual_ns
        return self.declared.delays(atom, Delays(usual_ns, usual_ns))

    def on_its_way_ns(self) -> int:
        """Return how long a verdict that has been reached may be on its way: twice as much as the latest ones
        differed, and SLACK_S at most.
        """
        spread_ns = self._clocks.spread_ns()
        return SLACK_NS if spread_ns is None else min(SLACK_NS, LEAST_SLACK_NS + 2 * spread_ns)

    def told_ns(self, source: str, time_ns: int) -> int:
        """Return when a source said something, by this computer's clock: the source's may be a minute off."""
        by_ours = time_ns + max(0, self._clocks.lives_on_ns(source))
        return min(by_ours, CLOCK.now_ns()) - CLOCK.ahead_ns

    def dating(self) -> Dating:
        """Return what dates the observations of a batch."""
        return Dating(self._robot.obs, self._clocks, self._usual_ns, self.twins)

    def sources(self) -> frozenset[str]:
        """Return who has reported anything since the service started, as far as it is remembered."""
        return self._clocks.sources()

    @property
    def _usual_ns(self) -> int:
        return round(self._robot.config.detection_s * 1e9)
