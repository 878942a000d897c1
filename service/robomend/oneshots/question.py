"""From text to a question: the sentences of one moment, and what is supposed."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal as OneOf

from robomend.diagnosis.result import Diagnosis, DiagnosisResult, Options
from robomend.entry import Entry
from robomend.errors import InputError, ObservationError
from robomend.model.clauses import Assertion
from robomend.model.sentences import MAX_LENGTH, tokens
from robomend.model.system import System, variant
from robomend.model.vocabulary import TRENDS, Vocabulary
from robomend.observations.language import Unknown, parse, read
from robomend.observations.obs import consequences
from robomend_client.literals import Atom, Literal

Opposites = OneOf["replace", "refuse"]
"""What a sentence does that contradicts one before it."""

CONNECTIVES = frozenset({"and", "or", "->", "<->", "forall", "exists"})


@dataclass(frozen=True, slots=True)
class Question:
    """One set of observations: what is known after OBS ⊕ each, and what says more than literals."""

    literals: frozenset[Literal]
    assertions: tuple[Assertion, ...] = ()


@dataclass(frozen=True, slots=True)
class PackedQuestion:
    """A model's text and a question about it, read by a worker: for another worker, which answers it.

    Of a large model the service holds bytes, not ten thousands of names that it would have to make, look
    through for garbage and free again.
    """

    version: str  # by which a worker knows the model's engine again
    model: bytes
    literals: bytes
    options: Options

    @classmethod
    def of(cls, version: str, system: System, asked: Question, options: Options) -> PackedQuestion:
        """Pack a question; its assertions become rules of the model."""
        version, cnf = variant(version, asked.assertions), system.extended(asked.assertions).cnf
        return cls(version, pickle.dumps(cnf), pickle.dumps(asked.literals), options)


def question(
    sentences: Iterable[str],
    vocabulary: Vocabulary,
    *,
    unknown: Unknown = "refuse",
    opposites: Opposites = "replace",
) -> Question:
    """Return what sentences say together, in their order.

    Args:
        sentences: literals, conjunctions of them, or anything richer, which becomes an assertion.
        vocabulary: of the model.
        unknown: what to do with names that the model does not declare.
        opposites: "replace": the later sentence counts, as in OBS; "refuse": all are of one moment.

    Raises:
        ObservationError: a sentence cannot be read.
        InputError: two contradict one another, where that is refused.
    """
    spoken: list[Literal] = []
    assertions: list[Assertion] = []
    for sentence in sentences:
        try:
            spoken += parse(sentence, vocabulary, unknown=unknown)
        except ObservationError:
            if not isinstance(sentence, str):
                raise
            said = read(sentence, vocabulary, name=sentence, unknown=unknown)
            if not isinstance(said, Assertion):
                raise
            assertions.append(said)
    return together(spoken, assertions, opposites)


def together(spoken: Sequence[Literal], assertions: Iterable[Assertion], opposites: Opposites) -> Question:
    """Return the question that literals, in their order, and assertions make.

    Raises:
        InputError: two literals contradict one another, where that is refused.
    """
    return Question(_held(spoken, opposites), tuple(assertions))


def _held(spoken: Sequence[Literal], opposites: Opposites) -> frozenset[Literal]:
    # Tuples of strings are hashed in C, literals are not; mostly there is nothing to replace.
    atoms = {((atom := literal.atom).predicate, atom.args) for literal in spoken}
    if len(atoms) == len(spoken) and {predicate for predicate, _ in atoms}.isdisjoint(TRENDS):
        return frozenset(spoken)
    known: dict[Atom, tuple[Literal, Literal]] = {}  # what holds, and what was said for it
    for literal in spoken:
        for entry in consequences(Entry(literal, "", 0)):
            held = entry.literal
            before = known.get(held.atom)
            if opposites == "refuse" and before is not None and before[0] != held:
                raise InputError(f"the observations hold both {before[1]} and {literal}")
            known[held.atom] = held, literal
    return frozenset([held for held, _ in known.values()])


def sentences_of(line: str) -> list[str]:
    """Return the sentences of a line: a JSON array of them, or sentences with commas or nothing between.

    Raises:
        ObservationError: no JSON array, or what no sentence begins with.
    """
    stripped = line.strip()
    if stripped.startswith("["):
        try:
            return list(json.loads(stripped))
        except (ValueError, RecursionError) as error:
            position = getattr(error, "pos", 0)
            raise ObservationError(f"not a JSON array: {error}", stripped[:200], position) from error
    return _literals_of(stripped)


def _literals_of(line: str) -> list[str]:
    """Cut `v(1) not v(2), v(3)` into literals; what holds an `and`, `or` or arrow is one sentence."""
    if not line:
        return []
    if len(line) > MAX_LENGTH:
        raise ObservationError(f"more than {MAX_LENGTH} characters: write it as a JSON array", line[:80])
    found = tokens(line)
    if any(token.kind in CONNECTIVES for token in found):
        return [line]
    cuts = [0]
    depth = 0
    for before, token in pairwise(found):
        depth += (before.kind == "(") - (before.kind == ")")
        starts = token.kind in ("name", "quoted", "not", "end") and before.kind != "not"
        if depth == 0 and (token.kind == "," or (starts and before.kind != ",")):
            cuts.append(token.position)
    parts = (line[start:end].strip().lstrip(",").strip() for start, end in pairwise(cuts))
    return [part for part in parts if part]


def supposing(options: Options, system: System) -> Options:
    """Return the options of a what-if with their components as the model writes them.

    Raises:
        UnknownComponent: what-if of something that the model does not have.
        InputError: a component is assumed to be both.
    """
    healthy = frozenset(system.named(sorted(options.healthy)))
    abnormal = frozenset(system.named(sorted(options.abnormal)))
    if both := sorted(healthy & abnormal):
        raise InputError(f"{', '.join(both)} cannot be assumed healthy and abnormal at once")
    return replace(options, healthy=healthy, abnormal=abnormal)


def given_diagnosis(bad: Iterable[str], system: System) -> DiagnosisResult:
    """Return a diagnosis that somebody made, as if an engine had; UnknownComponent if it cannot be one."""
    only = Diagnosis(tuple(dict.fromkeys(system.named(bad))))
    return DiagnosisResult(system.cnf.components, (only,), True, None, (), 0.0)
