"""What the distinct codes of a log come to: each is asked once, and what they have in common is kept once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal as OneOf

import numpy as np
from numpy.typing import NDArray

from robomend.diagnosis.library import SENSORS_A_WORD, Codes, Library
from robomend.diagnosis.library import Answer as LibraryAnswer
from robomend.diagnosis.result import Options
from robomend.diagnosis.snapshots import SnapshotEngine
from robomend.errors import ContradictoryModel
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Atom, Literal

State = OneOf["healthy", "faulty", "unknown", "contradictory"]

Names = tuple[str, ...]

REMEMBERED = 50_000
"""Sets of states that were asked together."""


@dataclass(frozen=True, slots=True)
class Told:
    """What is told of a code; equal ones are one.

    `unknown`: nothing was observed that a rule speaks of. `contradictory`: the observations contradict the
    model, whatever is abnormal.
    """

    state: State
    bad: tuple[Names, ...] | None  # of each diagnosis; None: nothing was observed
    probability: tuple[float, ...] | None  # of each; None: the model has no priors
    conflicts: tuple[Names, ...] | None  # the minimal ones; None: they are not known
    complete: bool
    stopped_by: str | None
    smallest_proved: bool = True  # of a search that was stopped: it has found the smallest diagnoses
    size_at_least: int | None = None  # of the smallest diagnosis; None: there is none, or it is not known
    size_at_most: int | None = None


NOTHING = Told("unknown", None, None, (), True, None)


class Answers:
    """The answers of one model, for codes of any sensors."""

    def __init__(self, cnf: HealthCnf, options: Options) -> None:
        """`options` without conflicts: the library knows them by itself."""
        self._cnf = cnf
        self._options = options
        self._library: Library | None = None
        self._together: dict[frozenset[frozenset[Literal]], Told] = {}

    def close(self) -> None:
        """Free the solvers."""
        if self._library is not None:
            self._library.close()
            self._library = None

    def library(self, sensors: tuple[Atom, ...]) -> Library:
        """Return the library of these sensors; the last one is kept."""
        if self._library is None or self._library.sensors != sensors:
            self.close()
            self._library = Library(self._cnf, sensors, self._options)
        return self._library

    def told(self, codes: Codes, sensors: tuple[Atom, ...]) -> tuple[list[Told], NDArray[np.intp]]:
        """Return what is told of codes: different ones, and which of them a code has."""
        rows, row_of = distinct(codes)
        answers = self.library(sensors).diagnose(rows)
        number = {NOTHING: 0}
        of_answer = np.array(
            [
                number.setdefault(told_of(*one), len(number))
                for one in zip(answers.distinct, answers.conflicts, strict=True)
            ],
            dtype=np.intp,
        )
        numbers = of_answer[answers.index] if len(rows) else np.zeros(0, dtype=np.intp)
        numbers[~self.heard(rows, sensors)] = 0
        return [*number], numbers[row_of]

    @property
    def components(self) -> Names:
        """All that answers may name."""
        return self._cnf.components

    def said(self, sensors: tuple[Atom, ...]) -> list[str]:
        """Return all that grounds may name."""
        return [str(literal) for literal in self.library(sensors).said]

    def grounds(
        self, codes: Codes, sensors: tuple[Atom, ...]
    ) -> tuple[Iterator[list[str]], NDArray[np.intp]]:
        """Return the observations that the answers of codes rest on: distinct ones, and which a code has."""
        library = self.library(sensors)
        states, state_of = distinct(codes)
        rows, row_of = distinct(library.grounds(states))
        text = {literal: str(literal) for literal in library.said}
        texts = ([text[literal] for literal in library.literals(row)] for row in rows.tolist())
        return texts, row_of[state_of]

    def heard(self, codes: Codes, sensors: tuple[Atom, ...]) -> NDArray[np.bool_]:
        """Return of each code whether it says anything that a rule speaks of."""
        return np.asarray(((codes & self._heard(sensors)) != 0).any(axis=1))

    def together(self, rows: frozenset[tuple[int, ...]], sensors: tuple[Atom, ...]) -> tuple[Told, list[str]]:
        """Return what is told of several codes at once, and the observations that it rests on.

        Args:
            rows: the codes, without the zeros at their ends.
            sensors: of the codes; further ones only join behind them.
        """
        library = self.library(sensors)
        padded = [[*row, *[0] * (library.words - len(row))] for row in sorted(rows)]
        snapshots = [library.literals(row) for row in padded]
        seen = dict.fromkeys(str(literal) for snapshot in snapshots for literal in snapshot)
        asked = frozenset(map(frozenset, snapshots))  # of other logs, too, whose sensors have other numbers
        told = self._together.get(asked)
        if told is None:
            if len(self._together) >= REMEMBERED:
                self._together.clear()
            conflicts = None
            if library.whole:
                applying = library.diagnose(np.array(padded, dtype=np.uint64)).conflicts
                conflicts = smallest(conflict for of_one in applying for conflict in of_one or ())
            told = self._together[asked] = self._of_snapshots(snapshots, conflicts)
        return told, list(seen)

    def _of_snapshots(self, snapshots: list[list[Literal]], conflicts: tuple[Names, ...] | None) -> Told:
        engine = SnapshotEngine(self._cnf)  # a fresh one: what it met before could decide what a limit leaves
        try:
            return told_of(engine.diagnose(snapshots, self._options), conflicts)
        except ContradictoryModel as contradiction:
            return told_of(contradiction, conflicts)
        finally:
            engine.close()

    def _heard(self, sensors: tuple[Atom, ...]) -> Codes:
        """Return the bits of sensors that a rule speaks of."""
        heard = [0] * max(1, -(-len(sensors) // SENSORS_A_WORD))
        for number, atom in enumerate(sensors):
            if atom in self._cnf.atom_variable:
                word, place = divmod(number, SENSORS_A_WORD)
                heard[word] |= 3 << (2 * place)
        return np.array(heard, dtype=np.uint64)


def told_of(answer: LibraryAnswer, conflicts: tuple[Names, ...] | None) -> Told:
    """Return what the results say of an answer."""
    if isinstance(answer, ContradictoryModel):
        return Told("contradictory", (), None, conflicts, True, None)
    bad = tuple([diagnosis.bad for diagnosis in answer.diagnoses])
    odds = tuple([d.probability for d in answer.diagnoses if d.probability is not None])
    return Told(
        "healthy" if answer.healthy else "faulty",
        bad,
        odds if len(odds) == len(bad) and bad else None,
        conflicts,
        answer.complete,
        answer.stopped_by,
        answer.smallest_proved,
        answer.size_at_least,
        answer.size_at_most,
    )


def smallest(conflicts: Iterable[Names]) -> tuple[Names, ...]:
    """Return the conflicts that contain no other one, in the order of their names."""
    found = sorted(set(conflicts))
    return tuple(one for one in found if not any(set(other) < set(one) for other in found))


def distinct(codes: Codes) -> tuple[Codes, NDArray[np.intp]]:
    """Return the different rows, and which of them each row is; in the order of their bits."""
    if codes.shape[1] == 1:
        found, of = np.unique(codes[:, 0], return_inverse=True)
        return found.reshape(-1, 1), of.reshape(-1)
    found, of = np.unique(codes, axis=0, return_inverse=True)
    return found, of.reshape(-1)


def widened(codes: Codes, words: int) -> Codes:
    """Return codes with more sensors, of which nothing is known."""
    missing = words - codes.shape[1]
    if missing <= 0:
        return codes
    return np.concatenate([codes, np.zeros((len(codes), missing), dtype=np.uint64)], axis=1)
