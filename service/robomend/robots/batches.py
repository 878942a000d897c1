"""What comes in as sentences, read in a robot's vocabulary: entries for OBS, and assertions.

    Batch (text) ──read──► Update (literals with who and when) ──⊕──► entries of OBS, which the store keeps

Each is another type because it means something else; nothing is copied from one to the next otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import structlog

from robomend.entry import Entry
from robomend.errors import InputError, ObservationError, TooLarge
from robomend.model.budget import check_steps
from robomend.model.clauses import Assertion
from robomend.model.system import System
from robomend.model.vocabulary import ACTIVE, HAS_VARIANT, Vocabulary
from robomend.observations.language import Unknown, parse
from robomend.observations.obs import Obs
from robomend.robots.clock import AHEAD_NS, CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.dating import Dating, check_parallel
from robomend.robots.readers import Readers
from robomend.settings import Settings
from robomend.store.records import StoredAssertion, StoredModel
from robomend.yielding import Turns
from robomend_client.literals import Atom, Literal
from robomend_client.readings import Reading, Symptom

log = structlog.get_logger("robomend.robots.batches")

MAX_REFUSED = 100
"""Bad sentences of one batch of which the good ones are kept."""


@dataclass(frozen=True)
class Batch:
    """Sentences of one source at one time, as they come in."""

    observations: Sequence[str] = ()
    assertions: Mapping[str, str] = field(default_factory=dict)
    time_ns: int | None = None  # None: now
    source: str | None = None  # None: the name of whoever reports it
    lifetime_s: float | None = None
    together: bool = True  # one bad sentence refuses the batch
    since: Sequence[int | None] = ()  # for each observation the beginning of what it rests on
    onset: Sequence[int | None] = ()  # … and the last good sample before it turned bad
    unknown: Sequence[str] = ()  # atoms that are unknown from now on
    settled: int | None = None  # the number of the `settle` that this answers
    readings: Sequence[Reading | None] = ()  # for each observation what was measured

    def later(self, by_ns: int) -> Batch:
        """Return it with its times brought to a clock that is so far ahead."""
        if by_ns == 0 or self.time_ns is None:
            return self
        since = [None if time_ns is None else time_ns + by_ns for time_ns in self.since]
        onset = [None if time_ns is None else time_ns + by_ns for time_ns in self.onset]
        return Batch(
            self.observations,
            self.assertions,
            self.time_ns + by_ns,
            self.source,
            self.lifetime_s,
            self.together,
            since,
            onset,
            self.unknown,
            self.settled,
            self.readings,
        )


class Update(NamedTuple):
    """What OBS is to take in: entries in the order in which they came, and what else changes."""

    entries: Sequence[Entry] = ()
    asserted: Sequence[tuple[Assertion, StoredAssertion]] = ()
    withdrawn: Sequence[str] = ()  # names of assertions
    retracted: Sequence[tuple[Atom, str]] = ()  # of which a source, too, knows nothing any more
    refused: Sequence[ObservationError] = ()  # sentences that are not in it
    dated: bool = False  # each batch says when it was: taking it in once more, later, changes nothing

    @property
    def empty(self) -> bool:
        """Whether there is nothing to keep."""
        return not (self.entries or self.asserted or self.withdrawn or self.retracted)

    async def ready(self, _: object) -> Update:
        """Return it: how to read what is read already."""
        return self

    def check_room(self, obs: Obs, settings: Settings) -> None:
        """Refuse what there is no room for, beside what is in OBS.

        Raises:
            TooLarge: too many literals.
            ObservationError: too many steps of richer sentences.
        """
        room = settings.max_observed
        if len(obs) >= room and len(obs) + len(self.entries) > room:
            raise TooLarge(f"OBS of this robot holds {room} literals; max_observed is reached")
        if self.asserted:
            steps = {name: assertion.steps for name, assertion in obs.assertions.items()}
            for assertion, _ in self.asserted:
                steps[assertion.name] = assertion.steps
                check_steps(sum(steps.values()), settings.max_assertion_steps, assertion.text)


class Acknowledged(NamedTuple):
    """What became of a batch."""

    revision: int
    changed: Sequence[str]
    refused: Sequence[ObservationError] = ()


@dataclass(frozen=True, slots=True)
class Words:
    """In which sentences are read: a version's vocabulary, and what becomes of names that are not in it."""

    version: str  # names the vocabulary, which a worker keeps
    vocabulary: Vocabulary
    unknown: Unknown

    @classmethod
    def of(cls, model: StoredModel, system: System, config: RobotConfig) -> Words:
        """Return those of a robot that follows this version."""
        unknown: Unknown = "keep" if config.keep_unknown else "refuse"
        return cls(f"{model.name}@{model.version}", system.vocabulary, unknown)


async def read_batches(
    words: Words, batches: Sequence[Batch], readers: Readers, dating: Dating, by: str
) -> Update:
    """Read the sentences of batches, as one update; in turns, and long ones in a worker.

    Raises:
        ObservationError: the sentence at fault, where its batch is kept or refused together.
        InputError: a batch is from too far in the future, or its evidence does not fit it.
    """
    now_ns, turns = CLOCK.now_ns(), Turns()
    vocabulary, unknown = words.vocabulary, words.unknown
    entries: list[Entry] = []
    asserted: list[tuple[Assertion, StoredAssertion]] = []
    refused: list[ObservationError] = []
    newest: dict[tuple[Atom, str], Entry] = {}  # what each source says of each atom in these batches
    retracted: dict[tuple[Atom, str], None] = {}
    for given in batches:
        source = given.source or by
        batch = given.later(_set_back_ns(given, now_ns))
        at_ns = _time_ns(batch, now_ns)
        rests_on = dating.of(source, at_ns, now_ns, len(batch.observations), batch.since, batch.onset)
        readings = batch.readings
        check_parallel("readings", readings, len(batch.observations))
        behind_ns = dating.clocks.behind_ns(source)
        if behind_ns:
            batch = batch.later(behind_ns)
            at_ns = _time_ns(batch, now_ns)
        expires_ns = None
        if batch.lifetime_s is not None:
            expires_ns = at_ns + round(batch.lifetime_s * 1e9) + dating.clocks.lives_on_ns(source)
        # A stamp ahead of us is a clock that is ahead; taken as it is, it would outlive what is said when the
        # clock is right again.
        at_ns = min(at_ns, now_ns)
        for sentence in batch.unknown:
            try:
                for literal in parse(sentence, vocabulary, unknown=unknown):
                    held = newest.get((literal.atom, source)) or dating.obs.word(literal.atom, source)
                    # What another source says of it, or this one has said since, still stands.
                    if held is not None and held.source == source and held.time_ns <= at_ns:
                        retracted[literal.atom, source] = None
            except ObservationError as error:
                _refuse(batch, refused, error)
            await turns.rest()
        said: dict[Atom, bool] = {}  # in this batch, which is of one moment
        first = len(entries)
        for position, sentence in enumerate(batch.observations):
            try:
                for literal in parse(sentence, vocabulary, unknown=unknown):
                    if said.setdefault(literal.atom, literal.positive) != literal.positive:
                        why = f"the batch says both {literal.atom} and not {literal.atom}, of one moment"
                        raise ObservationError(why, sentence, 0)
                    since_ns, onset_ns = rests_on(literal, position)
                    reading = readings[position] if readings else None
                    entry = Entry(
                        literal, source, at_ns, expires_ns, since_ns, onset_ns, batch.settled, reading
                    )
                    if reading is not None and reading.symptom is Symptom.SILENT:
                        unseen = bool(batch.since) and not (batch.onset and batch.onset[position])
                        entry = replace(entry, deaf=unseen and not literal.positive)
                    entries.append(entry)
                    newest[literal.atom, source] = entry
                    if retracted:
                        retracted.pop((literal.atom, source), None)
            except ObservationError as error:
                _refuse(batch, refused, error)
            if turns.over:
                await turns.end()
        if ACTIVE in vocabulary.predicates:
            entries += _not_active(entries[first:], vocabulary)
        for name, sentence in batch.assertions.items():
            record = StoredAssertion(name, sentence, source, at_ns, expires_ns)
            try:
                read = await readers.assertion(words.version, vocabulary, name, sentence, unknown=unknown)
                asserted.append((read, record))
            except ObservationError as error:
                _refuse(batch, refused, error)
            await turns.rest()
    dated = None not in [batch.time_ns for batch in batches]
    return Update(entries, asserted, retracted=tuple(retracted), refused=refused, dated=dated)


def _not_active(said: Sequence[Entry], vocabulary: Vocabulary) -> list[Entry]:
    """Return what a batch denies by what it says to be active: the function's other variants, as far as it
    says nothing of them itself.
    """
    spoken = {entry.atom for entry in said}
    denied: list[Entry] = []
    for entry in said:
        if entry.atom.predicate == ACTIVE and entry.positive:
            for function, variant in sorted(vocabulary.relations[HAS_VARIANT]):
                atom = Atom(ACTIVE, (function, variant))
                if function == entry.atom.args[0] and atom not in spoken:
                    spoken.add(atom)
                    denied.append(replace(entry, literal=Literal(atom, False), reading=None))
    return denied


def _refuse(batch: Batch, refused: list[ObservationError], error: ObservationError) -> None:
    """Note a bad sentence where the others are kept. Many are no slips, and each takes time to explain."""
    if batch.together:
        raise error
    if len(refused) >= MAX_REFUSED:
        raise ObservationError(
            f"{MAX_REFUSED} sentences of this batch are refused already; is it meant for another model?",
            error.sentence,
            error.position,
        )
    refused.append(error)


def _set_back_ns(batch: Batch, now_ns: int) -> int:
    """Return how far our clock is ahead of that of a batch because the computer's clock went back.

    A batch's clock is taken for the nearer one: the computer's, or ours, from which agents on this computer
    go on as well. So a stamp that is ahead of the computer's clock is told so, and is not old by ours.
    """
    ahead_ns = CLOCK.set_back_ns(now_ns)
    if not ahead_ns or batch.time_ns is None:
        return 0
    by_computer_ns = CLOCK.now_ns() - ahead_ns
    return ahead_ns if batch.time_ns <= by_computer_ns + max(AHEAD_NS, ahead_ns // 2) else 0


def _time_ns(batch: Batch, now_ns: int) -> int:
    """Return when a batch was observed, by our clock."""
    at_ns = now_ns if batch.time_ns is None else batch.time_ns
    if at_ns > now_ns + AHEAD_NS:
        ahead_s = (at_ns - now_ns) / 1e9
        raise InputError(
            f"time: {at_ns} is {ahead_s:.0f} s ahead of this service's clock; 60 are allowed: set the "
            "sender's clock, or this computer's (NTP), or leave `time` out, and it counts as of its arrival"
        )
    return at_ns


async def stored_assertion(
    robot: str, record: StoredAssertion, words: Words, readers: Readers
) -> Assertion | None:
    """Return a stored assertion in the present model's vocabulary; None if that has no words for it."""
    try:
        return await readers.assertion(
            words.version, words.vocabulary, record.name, record.sentence, unknown=words.unknown
        )
    except ObservationError as error:
        log.warning("assertion set aside", robot=robot, assertion=record.name, detail=str(error))
        return None
