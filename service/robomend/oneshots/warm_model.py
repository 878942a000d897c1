"""Many observation sets of one model, quickly: engines kept warm, equal sets answered once.

    with WarmModel(system, "sat", Options()) as model:
        for line in file:
            explained = model.ask_line(line)
            explained.result, explained.text(elapsed_s=…)

Logs repeat few distinct sets, so what was answered for good is remembered by its literals. Values come out,
and text when asked for; nothing here needs a service, so that logs are diagnosed with it as well.
A question is the sentences of one moment, and what is supposed.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import TracebackType
from typing import Literal as OneOf

from robomend.diagnosis.engines import DEFAULT, make_engine
from robomend.diagnosis.probes import Prober, ProbeResult
from robomend.diagnosis.ranking import most_probable_first, rank
from robomend.diagnosis.result import Diagnosis, DiagnosisResult, Engine, Options
from robomend.diagnosis.snapshots import diagnose_snapshots
from robomend.entry import Entry
from robomend.errors import InputError, ObservationError, OptionRefused
from robomend.model.clauses import Assertion
from robomend.model.cnf import HealthCnf
from robomend.model.packed import opened
from robomend.model.sentences import MAX_LENGTH, tokens
from robomend.model.system import System, variant
from robomend.model.vocabulary import TRENDS, Vocabulary
from robomend.observations.language import Unknown, parse, read
from robomend.observations.obs import consequences
from robomend.oneshots.result_json import quoted_names, result_text, timed, timeless
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


REMEMBERED = 2000
"""Answers kept; the oldest goes first."""

KEPT_TEXT = 100_000
"""Characters of an answer's text that are kept; a longer one is made again each time."""

ENGINES = 8
"""Warm engines: one for the model, and one for each set of assertions last seen."""


class Explained:
    """The answer to one question, and to every equal one."""

    __slots__ = ("_quoted", "_text", "elapsed_s", "healthy", "result")

    def __init__(self, result: DiagnosisResult, quoted: Mapping[str, str]) -> None:
        self.result = result
        self.elapsed_s = result.elapsed_s
        self.healthy = result.healthy
        self._quoted = quoted
        self._text: str | None = None  # up to the time

    @property
    def final(self) -> bool:
        """Whether asking again would not better it."""
        return self.result.stopped_by != "time"

    def text(self, elapsed_s: float) -> str:
        """Return the result as compact JSON with the time that this answer took.

        One that was known already took less than the diagnosis did; none takes more.
        """
        text = self._text
        if text is None:
            text = timeless(result_text(self.result, self._quoted))
            if len(text) <= KEPT_TEXT:
                self._text = text
        return timed(text, elapsed_s if elapsed_s < self.elapsed_s else self.elapsed_s)


class WarmModel:
    """One model and one engine, asked in the same way again and again."""

    def __init__(
        self,
        system: System,
        engine: str = DEFAULT,
        options: Options | None = None,
        *,
        unknown: Unknown = "refuse",
        expected_stopped: Iterable[str] = (),
    ) -> None:
        """Start the engine.

        Raises:
            OptionRefused: there is no such engine.
            UnknownComponent: the options or `expected_stopped` speak of what the model does not have.
        """
        self.system = system.extended(expected_stopped=system.named(expected_stopped))
        self.options = supposing(options or Options(), system)
        self.engine_name = engine
        self._unknown: Unknown = unknown
        self._engines: dict[tuple[Assertion, ...], tuple[Engine, HealthCnf]] = {}
        self._explained: dict[Question, Explained] = {}
        self._by_line: dict[str, Explained] = {}
        self._quoted = quoted_names(system.cnf.components)
        self._engine(())

    def __enter__(self) -> WarmModel:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the solvers."""
        for engine, _ in self._engines.values():
            engine.close()
        self._engines.clear()

    def question(self, sentences: Iterable[str]) -> Question:
        """Return what a sequence of sentences says; InputError as robomend.oneshots.warm_model."""
        return question(sentences, self.system.vocabulary, unknown=self._unknown)

    def ask_line(self, line: str) -> Explained:
        """Answer a line of sentences; see `sentences_of`."""
        explained = self._by_line.get(line)
        if explained is None:
            explained = self.ask(self.question(sentences_of(line)))
            if explained.final:
                if len(self._by_line) >= REMEMBERED:
                    self._by_line.clear()
                self._by_line[line] = explained
        return explained

    def ask(self, asked: Question) -> Explained:
        """Answer a question, or tell the answer again.

        Raises:
            ContradictoryModel: no model even with everything abnormal.
            OptionRefused: the engine cannot honour an option.
        """
        explained = self._explained.get(asked)
        if explained is None:
            engine, cnf = self._engine(asked.assertions)
            result = ask_engine(engine, cnf, asked.literals, self.options)
            explained = Explained(result, self._quoted)
            if explained.final:
                if len(self._explained) >= REMEMBERED:
                    del self._explained[next(iter(self._explained))]
                self._explained[asked] = explained
        return explained

    def probes(
        self, asked: Question, result: DiagnosisResult, *, limit: int, timeout_s: float
    ) -> ProbeResult:
        """Return what to look at next, given the answer to a question; see Prober.probes."""
        prober = Prober(opened(self.system.extended(asked.assertions).cnf))
        try:
            return prober.probes(sorted(asked.literals), result, limit=limit, timeout_s=timeout_s)
        finally:
            prober.close()

    def ask_together(self, questions: Iterable[Question]) -> DiagnosisResult:
        """Return the fault sets that explain every set: snapshots of one robot with the same faults.

        Raises:
            OptionRefused: a sentence is richer than literals, or the options are for single observations.
        """
        snapshots: list[list[Literal]] = []
        for number, asked in enumerate(questions, 1):
            if asked.assertions:
                raise OptionRefused(f"snapshot {number}: snapshots are literals only, nothing richer")
            snapshots.append(sorted(asked.literals))
        return explain_snapshots(opened(self.system.cnf), snapshots, self.engine_name, self.options)

    def _engine(self, assertions: tuple[Assertion, ...]) -> tuple[Engine, HealthCnf]:
        found = self._engines.get(assertions)
        if found is None:
            if len(self._engines) >= ENGINES:
                oldest = next(key for key in self._engines if key)
                self._engines.pop(oldest)[0].close()
            cnf = opened(self.system.extended(assertions).cnf)
            found = self._engines[assertions] = make_engine(self.engine_name, cnf), cnf
        return found


def ask_engine(
    engine: Engine, cnf: HealthCnf, literals: Iterable[Literal], options: Options
) -> DiagnosisResult:
    """Return an engine's answer, weighed by the model's priors if the engine did not do so itself, and of
    each size the most probable first.

    The literals are put in order first: which of several conflicts an engine finds depends on it, and a set
    has to have one answer whoever asks, in whatever process.
    """
    observed = sorted(literals, key=_order)
    result = engine.diagnose(observed, options)
    if all(diagnosis.probability is None for diagnosis in result.diagnoses):
        result = rank(result, cnf, options, observed)
    return most_probable_first(result, cnf, observed) if options.order == "size" else result


def _order(literal: Literal) -> tuple[str, tuple[str, ...], bool]:
    """Return what literals are sorted by: as they are by themselves, but compared in C."""
    atom = literal.atom
    return atom.predicate, atom.args, literal.positive


def explain_snapshots(
    cnf: HealthCnf, snapshots: Sequence[Sequence[Literal]], engine: str, options: Options
) -> DiagnosisResult:
    """Return the fault sets that explain every snapshot, with probabilities where there are priors.

    Raises:
        OptionRefused: another engine than the default was asked for.
    """
    if engine != DEFAULT:
        raise OptionRefused(f"several snapshots have an engine of their own: {engine!r} cannot be asked")
    return rank(diagnose_snapshots(cnf, snapshots, options), cnf, options)
