"""What the distinct codes of a log come to: each is asked once, and what they have in common is kept once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal as OneOf

import numpy as np
from numpy.typing import NDArray

from robomend.diagnosis.library import SENSORS_A_WORD, Codes, Library, distinct
from robomend.diagnosis.library import Answer as LibraryAnswer
from robomend.diagnosis.result import Options
from robomend.diagnosis.snapshots import SnapshotEngine
from robomend.errors import ContradictoryModel
from robomend.model.components import Criticality
from robomend.model.formulas import leaves
from robomend.model.packed import opened
from robomend.model.system import System
from robomend.model.vocabulary import ACTIVE
from robomend_client.literals import Atom, Literal

State = OneOf["healthy", "faulty", "degraded", "unknown", "contradictory"]

FAULTY: tuple[State, ...] = ("faulty", "degraded", "contradictory")
"""The states in which something is wrong."""

Names = tuple[str, ...]

REMEMBERED = 50_000
"""Sets of states that were asked together."""


@dataclass(frozen=True, slots=True)
class Told:
    """What is told of a code; equal ones are one.

    `degraded`: what is blamed is optional, or the functions work by variants that do without. `unknown`:
    nothing was observed that a rule speaks of. `contradictory`: the observations contradict the model,
    whatever is abnormal.
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

    def __init__(self, system: System, options: Options) -> None:
        """`options` without conflicts: the library knows them by itself."""
        self._cnf = opened(system.cnf)
        self._system = system
        parts = system.parts
        self._may_do_without = parts is not None and (
            bool(parts.functions) or any(p.criticality is Criticality.OPTIONAL for p in parts.parts.values())
        )
        conditions = (leaf.literal.atom for one in system.conditions.values() for leaf in leaves(one))
        self._of_functions = {*conditions}
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
        told = [*number]
        if self._may_do_without:
            numbers = self._by_variants(rows, sensors, told, numbers)
        return told, numbers[row_of]

    def _by_variants(
        self, rows: Codes, sensors: tuple[Atom, ...], told: list[Told], numbers: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        """Return what is told of codes once it is known where the robot does without; `told` grows."""
        faulty = np.flatnonzero(np.array([one.state == "faulty" for one in told])[numbers])
        if not len(faulty):
            return numbers
        asked = self.of_functions(rows[faulty], sensors)
        keys, of = distinct(np.column_stack([asked, numbers[faulty].astype(np.uint64)]))
        degraded: dict[int, int] = {}
        answers = np.empty(len(keys), dtype=np.intp)
        for place, (*row, number) in enumerate(keys.tolist()):
            answers[place] = number
            if self._does_without([row], sensors, told[number]):
                if number not in degraded:
                    degraded[number] = len(told)
                    told.append(replace(told[number], state="degraded"))
                answers[place] = degraded[number]
        found = numbers.copy()
        found[faulty] = answers[of]
        return found

    def _does_without(self, rows: Iterable[Sequence[int]], sensors: tuple[Atom, ...], told: Told) -> bool:
        """Return whether the robot did without what is blamed, in each of these codes."""
        from robomend.planning.configurations import Keeper, KnownState, does_without  # few robots have any

        parts = self._system.parts
        if parts is None or told.bad is None:
            return False
        for row in rows:
            state = {
                atom: row[number // SENSORS_A_WORD] >> 2 * (number % SENSORS_A_WORD) & 3
                for number, atom in enumerate(sensors)
                if number // SENSORS_A_WORD < len(row)
            }
            known = KnownState(
                lambda atom, state=state: {1: True, 2: False}.get(state.get(atom, 0)),  # type: ignore[misc]  # bound here
                lambda atom: None,  # codes have no numbers: a condition on them is not known to hold
                told.bad,
            )
            states = Keeper().decide(parts, self._system.conditions, known, 0).states
            if not does_without(parts, states, told.bad):
                return False
        return True

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

    def of_functions(self, codes: Codes, sensors: tuple[Atom, ...]) -> Codes:
        """Return of codes what functions and their conditions rest on."""
        of_them = [atom in self._of_functions or atom.predicate == ACTIVE for atom in sensors]
        return np.asarray(codes & _bits(of_them)) if self._may_do_without else np.zeros_like(codes)

    def together(
        self,
        rows: frozenset[tuple[int, ...]],
        sensors: tuple[Atom, ...],
        of_functions: Iterable[tuple[int, ...]],
    ) -> tuple[Told, list[str]]:
        """Return what is told of several codes at once, and the observations that it rests on.

        Args:
            rows: the codes, without the zeros at their ends.
            sensors: of the codes; further ones only join behind them.
            of_functions: what functions rest on, of all codes.
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
        if (
            told.state == "faulty"
            and self._may_do_without
            and self._does_without(of_functions, sensors, told)
        ):
            told = replace(told, state="degraded")
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
        return _bits([atom in self._cnf.atom_variable for atom in sensors])


def _bits(wanted: Sequence[bool]) -> Codes:
    """Return the bits of the sensors that are wanted."""
    found = [0] * max(1, -(-len(wanted) // SENSORS_A_WORD))
    for number, one in enumerate(wanted):
        if one:
            word, place = divmod(number, SENSORS_A_WORD)
            found[word] |= 3 << (2 * place)
    return np.array(found, dtype=np.uint64)


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


def widened(codes: Codes, words: int) -> Codes:
    """Return codes with more sensors, of which nothing is known."""
    missing = words - codes.shape[1]
    if missing <= 0:
        return codes
    return np.concatenate([codes, np.zeros((len(codes), missing), dtype=np.uint64)], axis=1)
