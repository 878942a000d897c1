"""From sentences to sensors: which bits of a code a literal sets and clears.

A sensor is an atom that a log speaks of; it gets the next number when it is first met. What a literal says
by the rules of OBS beside itself (`inc(v)` denies `dec(v)` and `const(v)`) is said here, once for each
literal: the rest is numbers.
"""

from __future__ import annotations

from typing import Any

from robomend.entry import Entry
from robomend.errors import ObservationError
from robomend.model.vocabulary import SYMMETRIC, TRENDS, Vocabulary
from robomend.observations.language import Unknown, parse
from robomend.observations.obs import MAX_ATOMS, consequences
from robomend_batch.problems import LogRefused, Problems
from robomend_client.literals import Atom, Literal
from robomend_client.observers import Change
from robomend_client.readings import Reading

TRUE, FALSE, UNKNOWN = 1, 0, -1

MOST_READINGS = 200
"""Of a log."""

Setting = tuple[int, int]
"""A sensor, and TRUE, FALSE or UNKNOWN."""


class Words:
    """The sensors of one log."""

    def __init__(self, vocabulary: Vocabulary, unknown: Unknown, problems: Problems) -> None:
        self._vocabulary = vocabulary
        self._unknown: Unknown = unknown
        self._problems = problems
        self._sensor: dict[Atom, int] = {}
        self._said: dict[str, tuple[Setting, ...]] = {}
        self.readings: list[dict[str, Any]] = []
        """What was measured where observers said that something turned bad; the first MOST_READINGS."""

    def measured(self, change: Change) -> None:
        """Note what an observer measured as it turned bad."""
        if len(self.readings) < MOST_READINGS and change.reading is not None:
            told = Reading.from_json(change.reading.as_json())
            self.readings.append(
                {"time_ns": change.time_ns, "literal": str(change.value), "reading": str(told)}
            )

    @property
    def sensors(self) -> tuple[Atom, ...]:
        """In the order of their numbers."""
        return tuple(self._sensor)

    def settings(self, sentence: str, place: str) -> tuple[Setting, ...]:
        """Return what a sentence sets, in its order.

        Raises:
            LogRefused: it cannot be read, or speaks of what the model does not declare.
        """
        found = self._said.get(sentence)
        if found is None:
            found = self._said[sentence] = tuple(
                setting for literal in self.literals(sentence, place) for setting in self.of(literal)
            )
        return found

    def literals(self, sentence: str, place: str) -> tuple[Literal, ...]:
        """Return the literals of a sentence; LogRefused as `settings`."""
        try:
            literals = parse(sentence, self._vocabulary, unknown=self._unknown)
        except ObservationError as error:
            raise LogRefused(str(error), place) from error
        if self._unknown == "keep":
            for literal in literals:
                if not self._vocabulary.declares(literal.atom):
                    self._problems.add(place.partition(":")[0], f"the model has no {literal.atom}", bad=False)
        return literals

    def canonical(self, literal: Literal) -> Literal:
        """Return a literal in the one spelling that OBS uses."""
        return self._vocabulary.canonical(literal)

    def of(self, literal: Literal) -> tuple[Setting, ...]:
        """Return what a literal of the model sets."""
        return tuple(
            (self.sensor(entry.literal.atom), TRUE if entry.literal.positive else FALSE)
            for entry in consequences(Entry(literal, "", 0))
        )

    def unknown(self, atom: Atom) -> tuple[Setting, ...]:
        """Return what it sets that nothing is known of an atom any more, nor of what it denied."""
        if atom.predicate in TRENDS and len(atom.args) == 1:
            return tuple((self.sensor(Atom(trend, atom.args)), UNKNOWN) for trend in TRENDS)
        if atom.predicate in SYMMETRIC and len(atom.args) == 2:
            atom = Atom(atom.predicate, tuple(sorted(atom.args)))
        return ((self.sensor(atom), UNKNOWN),)

    def sensor(self, atom: Atom) -> int:
        """Return the number of an atom, a new one if need be."""
        number = self._sensor.setdefault(atom, len(self._sensor))
        if number >= MAX_ATOMS:
            raise LogRefused(f"it speaks of more than {MAX_ATOMS} atoms", str(atom))
        return number
