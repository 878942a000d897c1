"""What comes in as sentences, read in a robot's vocabulary: literals with source and time, and assertions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import structlog

from robomend.errors import InputError, ObservationError
from robomend.model.clauses import Assertion
from robomend.model.system import System
from robomend.observations.language import Unknown, parse, read, read_assertion
from robomend.observations.obs import Observed
from robomend.robots.boards import SOURCE as BOARD
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.robot import AHEAD_NS, Robot
from robomend.store import records
from robomend_client.literals import Atom, Literal

log = structlog.get_logger("robomend.robots.batches")


@dataclass(frozen=True, slots=True)
class Batch:
    """Sentences of one source at one time."""

    observations: tuple[str, ...] = ()
    assertions: Mapping[str, str] = field(default_factory=dict)
    time_ns: int | None = None  # None: now
    source: str = "http"
    lifetime_s: float | None = None
    together: bool = True  # one bad sentence refuses the batch


@dataclass(frozen=True, slots=True)
class Acknowledged:
    """What became of a batch."""

    revision: int
    changed: tuple[str, ...]
    refused: tuple[ObservationError, ...] = ()


@dataclass(frozen=True, slots=True)
class ReadBatch:
    """A batch that was read, ready for OBS."""

    observed: tuple[Observed, ...] = ()
    asserted: tuple[tuple[Assertion, records.StoredAssertion], ...] = ()
    withdrawn: tuple[str, ...] = ()
    forgotten: tuple[Atom, ...] = ()
    refused: tuple[ObservationError, ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there is nothing to keep."""
        return not (self.observed or self.asserted or self.withdrawn or self.forgotten)


def read_batch(state: Robot, batch: Batch) -> ReadBatch:
    """Read a batch's sentences.

    Raises:
        ObservationError: the sentence at fault, where the batch is kept or refused together.
        InputError: the batch is from too far in the future.
    """
    now = CLOCK.now_ns()
    at = now if batch.time_ns is None else batch.time_ns
    if at > now + AHEAD_NS:
        ahead_s = (at - now) / 1e9
        raise InputError(f"time: {at} is {ahead_s:.0f} s ahead of this service's clock; 60 are allowed")
    expires = None if batch.lifetime_s is None else at + round(batch.lifetime_s * 1e9)
    vocabulary, unknown = state.system.vocabulary, _unknown(state.config)
    observed: list[Observed] = []
    asserted: list[tuple[Assertion, records.StoredAssertion]] = []
    refused: list[ObservationError] = []
    for sentence in batch.observations:
        try:
            for literal in parse(sentence, vocabulary, unknown=unknown):
                observed.append(Observed(literal, batch.source, at, expires))
        except ObservationError as error:
            if batch.together:
                raise
            refused.append(error)
    for name, sentence in batch.assertions.items():
        record = records.StoredAssertion(name, sentence, batch.source, at, expires)
        try:
            said = read(sentence, vocabulary, name=name, unknown=unknown)
            if not isinstance(said, Assertion):
                said = read_assertion(name, sentence, vocabulary, unknown=unknown)
            asserted.append((said, record))
        except ObservationError as error:
            if batch.together:
                raise
            refused.append(error)
    return ReadBatch(tuple(observed), tuple(asserted), refused=tuple(refused))


def board_batch(state: Robot, said: frozenset[Literal], time_ns: int) -> ReadBatch:
    """Return what a board changes in OBS by saying this: what is new, and to forget what it says no more."""
    declares = state.system.vocabulary.declares
    observed = tuple(
        Observed(literal, BOARD, time_ns)
        for literal in sorted(said)
        if declares(literal.atom)
        and ((held := state.obs.get(literal.atom)) is None or held.literal != literal)
    )
    atoms = {literal.atom for literal in said}
    forgotten = tuple(
        entry.literal.atom
        for entry in state.obs.entries()
        if entry.source == BOARD and entry.literal.atom not in atoms
    )
    return ReadBatch(observed=observed, forgotten=forgotten)


def stored_assertion(
    record: records.StoredAssertion, system: System, config: RobotConfig
) -> Assertion | None:
    """Return a stored assertion in the present model's vocabulary; None if that has no words for it."""
    try:
        return read_assertion(record.name, record.sentence, system.vocabulary, unknown=_unknown(config))
    except ObservationError as error:
        log.warning("assertion set aside", robot=config.id, assertion=record.name, detail=str(error))
        return None


def _unknown(config: RobotConfig) -> Unknown:
    return "keep" if config.keep_unknown else "refuse"
