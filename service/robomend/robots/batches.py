"""What comes in as sentences, read in a robot's vocabulary: literals with source and time, and assertions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import structlog

from robomend.errors import InputError, ObservationError
from robomend.model.clauses import Assertion
from robomend.observations.language import Unknown, parse
from robomend.observations.obs import Observed
from robomend.robots.boards import SOURCE as BOARD
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.readers import Readers
from robomend.robots.robot import AHEAD_NS, Robot
from robomend.store import records
from robomend.turns import Turns
from robomend_client.literals import Atom, Literal

log = structlog.get_logger("robomend.robots.batches")


MAX_REFUSED = 100
"""Bad sentences of one batch of which the good ones are kept."""


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


async def read_batch(state: Robot, batch: Batch, readers: Readers) -> ReadBatch:
    """Read a batch's sentences in the robot's vocabulary, in turns; long ones in a worker.

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
    turns = Turns()
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
            _refuse(refused, error)
        await turns.rest()
    for name, sentence in batch.assertions.items():
        record = records.StoredAssertion(name, sentence, batch.source, at, expires)
        try:
            said = await readers.assertion(vocabulary_key(state), vocabulary, name, sentence, unknown=unknown)
            asserted.append((said, record))
        except ObservationError as error:
            if batch.together:
                raise
            _refuse(refused, error)
        await turns.rest()
    return ReadBatch(tuple(observed), tuple(asserted), refused=tuple(refused))


def _refuse(refused: list[ObservationError], error: ObservationError) -> None:
    """Note a bad sentence. So many of them are no slips, and each takes a while to explain."""
    if len(refused) >= MAX_REFUSED:
        raise ObservationError(
            f"{MAX_REFUSED} sentences of this batch are refused already; is it meant for another model?",
            error.sentence,
            error.position,
        )
    refused.append(error)


def vocabulary_key(state: Robot) -> str:
    """Return what names the robot's vocabulary: equal for all that follow its version of the model."""
    return f"{state.model.name}@{state.model.version}"


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


async def stored_assertion(
    record: records.StoredAssertion, state: Robot, readers: Readers
) -> Assertion | None:
    """Return a stored assertion in the present model's vocabulary; None if that has no words for it."""
    vocabulary, unknown = state.system.vocabulary, _unknown(state.config)
    try:
        return await readers.assertion(
            vocabulary_key(state), vocabulary, record.name, record.sentence, unknown=unknown
        )
    except ObservationError as error:
        log.warning("assertion set aside", robot=state.id, assertion=record.name, detail=str(error))
        return None


def _unknown(config: RobotConfig) -> Unknown:
    return "keep" if config.keep_unknown else "refuse"
