"""What comes in as sentences, read in a robot's vocabulary: entries for OBS, and assertions.

    Batch (text) ──read──► Update (literals with who and when) ──⊕──► entries of OBS, which the store keeps

Each is another type because it means something else; nothing is copied from one to the next otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import structlog

from robomend.entry import Entry
from robomend.errors import InputError, ObservationError
from robomend.model.clauses import Assertion
from robomend.model.system import System
from robomend.observations.language import Unknown, parse, read, read_assertion
from robomend.robots.clock import AHEAD_NS, CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.store.records import StoredAssertion
from robomend_client.literals import Atom

log = structlog.get_logger("robomend.robots.batches")


@dataclass(frozen=True)
class Batch:
    """Sentences of one source at one time, as they come in."""

    observations: Sequence[str] = ()
    assertions: Mapping[str, str] = field(default_factory=dict)
    time_ns: int | None = None  # None: now
    source: str = "http"
    lifetime_s: float | None = None
    together: bool = True  # one bad sentence refuses the batch


@dataclass(frozen=True, slots=True)
class Update:
    """What OBS is to take in: entries in the order in which they came, and what else changes."""

    entries: Sequence[Entry] = ()
    asserted: Sequence[tuple[Assertion, StoredAssertion]] = ()
    withdrawn: Sequence[str] = ()  # names of assertions
    forgotten: Sequence[Atom] = ()
    refused: Sequence[ObservationError] = ()  # sentences that are not in it

    @property
    def empty(self) -> bool:
        """Whether there is nothing to keep."""
        return not (self.entries or self.asserted or self.withdrawn or self.forgotten)


@dataclass(frozen=True, slots=True)
class Acknowledged:
    """What became of a batch."""

    revision: int
    changed: Sequence[str]
    refused: Sequence[ObservationError] = ()


def read_batches(system: System, config: RobotConfig, batches: Iterable[Batch]) -> Update:
    """Read the sentences of batches, as one update.

    Raises:
        ObservationError: the sentence at fault, where its batch is kept or refused together.
        InputError: a batch is from too far in the future.
    """
    now_ns = CLOCK.now_ns()
    vocabulary, unknown = system.vocabulary, _unknown(config)
    entries: list[Entry] = []
    asserted: list[tuple[Assertion, StoredAssertion]] = []
    refused: list[ObservationError] = []
    for batch in batches:
        at_ns, expires_ns = _times(batch, now_ns)
        for sentence in batch.observations:
            try:
                for literal in parse(sentence, vocabulary, unknown=unknown):
                    entries.append(Entry(literal, batch.source, at_ns, expires_ns))
            except ObservationError as error:
                if batch.together:
                    raise
                refused.append(error)
        for name, sentence in batch.assertions.items():
            record = StoredAssertion(name, sentence, batch.source, at_ns, expires_ns)
            try:
                said = read(sentence, vocabulary, name=name, unknown=unknown)
                if not isinstance(said, Assertion):
                    said = read_assertion(name, sentence, vocabulary, unknown=unknown)
                asserted.append((said, record))
            except ObservationError as error:
                if batch.together:
                    raise
                refused.append(error)
    return Update(entries, asserted, refused=refused)


def _times(batch: Batch, now_ns: int) -> tuple[int, int | None]:
    """Return when a batch was observed, and until when it may be believed."""
    at_ns = now_ns if batch.time_ns is None else batch.time_ns
    if at_ns > now_ns + AHEAD_NS:
        ahead_s = (at_ns - now_ns) / 1e9
        raise InputError(f"time: {at_ns} is {ahead_s:.0f} s ahead of this service's clock; 60 are allowed")
    return at_ns, None if batch.lifetime_s is None else at_ns + round(batch.lifetime_s * 1e9)


def stored_assertion(record: StoredAssertion, system: System, config: RobotConfig) -> Assertion | None:
    """Return a stored assertion in the present model's vocabulary; None if that has no words for it."""
    try:
        return read_assertion(record.name, record.sentence, system.vocabulary, unknown=_unknown(config))
    except ObservationError as error:
        log.warning("assertion set aside", robot=config.id, assertion=record.name, detail=str(error))
        return None


def _unknown(config: RobotConfig) -> Unknown:
    return "keep" if config.keep_unknown else "refuse"
