"""Sentences to observations: literals for OBS, or a named assertion for what is richer.

Observers say literals, `ok(scan)`, `not running(rviz)`, and conjunctions of them; that is nearly all of the
traffic, so it has a short way: a cache per vocabulary, then one regular expression, then the parser of the
whole language (robomend.model.sentences, where the grammar stands). What says more than literals (`or`,
`->`, `forall`, …) is an assertion: it has a name, holds until it is withdrawn, and joins the system
description (robomend.model.clauses.extend).
"""

from __future__ import annotations

import re
from typing import Literal as OneOf

from robomend.errors import ObservationError
from robomend.model.budget import ASSERTION_STEPS, StepCount
from robomend.model.clauses import Assertion
from robomend.model.formulas import Formula, Leaf, conjuncts
from robomend.model.rules import ground, mapped
from robomend.model.sentences import MAX_LENGTH, plain
from robomend.model.sentences import parse as parse_formula
from robomend.model.vocabulary import DECIDED, Vocabulary
from robomend_client.literals import RESERVED, Atom, Literal

__all__ = ["Assertion", "Unknown", "parse", "read", "read_assertion", "says_literals"]

Unknown = OneOf["refuse", "keep"]
"""What to do with names that the model does not declare."""

CACHED = 8192
"""Sentences remembered per vocabulary; a fleet says the same few hundred over and over."""

CACHED_LENGTH = 200

SIMPLE = re.compile(r"\s*(not\s+|[~!¬]\s*)?([\w./-]+)\s*(?:\(\s*([\w./-]+)\s*\))?\s*\Z")


def parse(sentence: str, vocabulary: Vocabulary, *, unknown: Unknown = "refuse") -> tuple[Literal, ...]:
    """Return the canonical literals of a literal or a conjunction of literals.

    Raises:
        ObservationError: malformed, richer than that, contradictory in itself, or (with unknown="refuse")
            naming what the model does not declare; with the sentence and the 0-based position.
    """
    if not isinstance(sentence, str):
        raise ObservationError(
            f"an observation is a string, not {type(sentence).__name__}", str(sentence)[:80]
        )
    cache = vocabulary.cache[unknown == "keep"]
    found = cache.get(sentence)
    if found is None:
        found = _parse(sentence, vocabulary, unknown)
        if len(sentence) <= CACHED_LENGTH:
            if len(cache) >= CACHED:
                cache.clear()
            cache[sentence] = found
    return found


def read(
    sentence: str,
    vocabulary: Vocabulary,
    *,
    name: str,
    unknown: Unknown = "refuse",
    most: int = ASSERTION_STEPS,
) -> tuple[Literal, ...] | Assertion:
    """Return the literals of a plain sentence, or an assertion called `name` of a richer one.

    Raises:
        ObservationError: as parse and read_assertion.
    """
    if says_literals(sentence, vocabulary, unknown=unknown):
        return parse(sentence, vocabulary, unknown=unknown)
    return read_assertion(name, sentence, vocabulary, unknown=unknown, most=most)


def says_literals(sentence: str, vocabulary: Vocabulary, *, unknown: Unknown = "refuse") -> bool:
    """Return whether a sentence is for `parse`, and not richer than that.

    Raises:
        ObservationError: malformed.
    """
    if not isinstance(sentence, str) or sentence in vocabulary.cache[unknown == "keep"]:
        return True
    return conjuncts(_formula(sentence, vocabulary)) is not None


def read_assertion(
    name: str,
    sentence: str,
    vocabulary: Vocabulary,
    *,
    unknown: Unknown = "refuse",
    most: int = ASSERTION_STEPS,
) -> Assertion:
    """Return any sentence as an assertion: ground, its atoms canonical and declared.

    Args:
        most: steps that it may take (robomend.model.budget).

    Raises:
        ObservationError: malformed, too many steps, or naming what the model does not declare.
    """
    formula = _formula(sentence, vocabulary)
    steps = StepCount(vocabulary).check(formula, most, sentence)
    checked: dict[Literal, Literal] = {}  # instances repeat few literals

    def leaf(found: Leaf) -> Formula:
        if found.literal not in checked:
            checked[found.literal] = _known(found.literal, vocabulary, unknown, sentence, found.position)
        return Leaf(checked[found.literal], found.position)

    return Assertion(name, sentence, mapped(ground(formula, vocabulary), leaf), steps)


def _parse(sentence: str, vocabulary: Vocabulary, unknown: Unknown) -> tuple[Literal, ...]:
    match = SIMPLE.match(sentence) if len(sentence) <= MAX_LENGTH else None
    if match is not None:
        negation, predicate, name = match.groups()
        if predicate not in RESERVED and name not in RESERVED:
            args = () if name is None else (plain(name),)
            literal = Literal(Atom(plain(predicate), args), negation is None)
            return (_known(literal, vocabulary, unknown, sentence, match.start(2)),)
    formula = _formula(sentence, vocabulary)
    if conjuncts(formula) is None:
        raise ObservationError(
            "this says more than literals joined by `and`: give it a name and assert it", sentence
        )
    checked = mapped(formula, lambda leaf: _leaf(leaf, vocabulary, unknown, sentence))
    literals = tuple(dict.fromkeys(conjuncts(checked) or ()))
    for literal in literals:
        if -literal in literals:
            raise ObservationError(f"it says both {literal.atom} and not {literal.atom}", sentence)
    return literals


def _formula(sentence: str, vocabulary: Vocabulary) -> Formula:
    return parse_formula(sentence, vocabulary.sorts, vocabulary.relations)


def _leaf(leaf: Leaf, vocabulary: Vocabulary, unknown: Unknown, sentence: str) -> Leaf:
    return Leaf(_known(leaf.literal, vocabulary, unknown, sentence, leaf.position), leaf.position)


def _known(
    literal: Literal, vocabulary: Vocabulary, unknown: Unknown, sentence: str, position: int
) -> Literal:
    if unknown == "keep" and literal.atom.predicate not in DECIDED:
        return vocabulary.canonical(literal)
    return vocabulary.check(literal, sentence, position)
