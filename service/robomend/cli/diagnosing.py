"""Answers many observation sets of one model, quickly: engines kept warm, equal sets answered once.

Logs repeat few distinct sets, so what was answered completely is remembered by its literals; only
`elapsed_s` is then measured anew.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from robomend.cli.rendering import HEALTHY, Renderer
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.ranking import rank
from robomend.diagnosis.result import DiagnosisResult, Engine, Options
from robomend.diagnosis.snapshots import diagnose_snapshots
from robomend.entry import Entry
from robomend.errors import InputError, ObservationError, OptionRefused, UnknownComponent
from robomend.model.clauses import Assertion, extend, without_running
from robomend.model.cnf import HealthCnf
from robomend.model.system import System
from robomend.model.vocabulary import TRENDS
from robomend.observations.language import Unknown, parse, read
from robomend.observations.obs import Obs
from robomend_client.literals import Literal

REMEMBERED = 2000
"""Answers kept; the oldest goes first."""

ENGINES = 8
"""Warm engines: one for the model, and one for each set of assertions last seen."""


@dataclass(frozen=True, slots=True)
class Question:
    """One observation set: literals after ⊕, and what is richer."""

    literals: frozenset[Literal]
    assertions: tuple[Assertion, ...] = ()


class Diagnoser:
    """One model, one engine, the same options for every set."""

    def __init__(
        self,
        system: System,
        engine: str,
        options: Options,
        *,
        unknown: Unknown = "refuse",
        expect_stopped: Sequence[str] = (),
    ) -> None:
        self.system = system
        self.options = options
        self.unknown = unknown
        self.engine_name = engine
        self.cnf = without_running(system.cnf, expect_stopped)
        self._engines: dict[tuple[Assertion, ...], Engine] = {}
        self._remembered: dict[Question, str] = {}
        self._read: dict[str, Question] = {}
        self.render = Renderer(system.cnf.components, factored=options.factored)
        self._engine(())  # a name that there is not is refused at once

    def close(self) -> None:
        """Free the solvers."""
        for engine in self._engines.values():
            engine.close()
        self._engines.clear()

    def question(self, sentences: Iterable[str]) -> Question:
        """Return what a sequence of sentences says: OBS ⊕ each, in order; richer ones as assertions."""
        spoken: list[Literal] = []
        assertions: list[Assertion] = []
        for sentence in sentences:
            try:
                literals = parse(sentence, self.system.vocabulary, unknown=self.unknown)
            except ObservationError:
                if not isinstance(sentence, str):
                    raise
                said = read(sentence, self.system.vocabulary, name=sentence, unknown=self.unknown)
                if not isinstance(said, Assertion):
                    raise
                assertions.append(said)
                continue
            spoken.extend(literals)
        if any(literal.atom.predicate in TRENDS for literal in spoken):
            obs = Obs()
            obs.update(Entry(literal, "", 0) for literal in spoken)
            return Question(frozenset(obs.literals(0)), tuple(assertions))
        return Question(frozenset({literal.atom: literal for literal in spoken}.values()), tuple(assertions))

    def answer(self, question: Question) -> DiagnosisResult:
        """Return the engine's answer to one set, with probabilities where the model has priors."""
        engine = self._engine(question.assertions)
        result = engine.diagnose(sorted(question.literals), self.options)
        if any(diagnosis.probability is not None for diagnosis in result.diagnoses):
            return result  # the engine weighs by itself
        return rank(result, self.cnf, self.options)

    def together(self, sets: Iterable[str]) -> DiagnosisResult:
        """Return the fault sets that explain every line: snapshots of one robot with the same faults.

        Raises:
            InputError: a line cannot be read; one that is missing would change the answer.
            OptionRefused: a sentence is richer than literals, or the options are for single observations.
        """
        snapshots: list[list[Literal]] = []
        for number, line in enumerate(sets, 1):
            try:
                question = self.question(sentences_of(line))
            except InputError as error:
                raise InputError(f"snapshot {number}: {error}") from error
            if question.assertions:
                raise OptionRefused(f"snapshot {number}: --together takes literals only, nothing richer")
            snapshots.append(sorted(question.literals))
        return explain_snapshots(self.cnf, snapshots, self.engine_name, self.options)

    def lines(self, sets: Iterable[str]) -> Iterator[tuple[str, bool]]:
        """Yield one JSON object per line, in order, with whether it is healthy.

        A line that is refused, or contradicts the model, gets `{"error": {"code": …, "message": …}}` in its
        place.
        """
        for line in sets:
            started = time.perf_counter()
            try:
                question = self._read.get(line)
                if question is None:
                    question = self.question(sentences_of(line))
                    if len(self._read) >= REMEMBERED:
                        self._read.clear()
                    self._read[line] = question
                text = self._remembered.get(question)
                if text is None:
                    result = self.answer(question)
                    text = self.render(result)
                    healthy = result.healthy
                    if result.stopped_by != "time":
                        if len(self._remembered) >= REMEMBERED:
                            del self._remembered[next(iter(self._remembered))]
                        self._remembered[question] = text
                    yield text, healthy
                else:
                    elapsed = time.perf_counter() - started
                    head, _, _ = text.rpartition(',"elapsed_s":')
                    yield f'{head},"elapsed_s":{elapsed:.6f}}}', head.startswith(HEALTHY)
            except InputError as error:
                problem = {"code": error.code, "message": str(error)}
                yield json.dumps({"error": problem}, ensure_ascii=False, separators=(",", ":")), False

    def _engine(self, assertions: tuple[Assertion, ...]) -> Engine:
        if assertions not in self._engines:
            if len(self._engines) >= ENGINES:
                oldest = next(key for key in self._engines if key)
                self._engines.pop(oldest).close()
            self._engines[assertions] = make_engine(self.engine_name, extend(self.cnf, assertions))
        return self._engines[assertions]


def explain_snapshots(
    cnf: HealthCnf, snapshots: Sequence[Sequence[Literal]], engine: str, options: Options
) -> DiagnosisResult:
    """Return the fault sets that explain every snapshot, with probabilities where there are priors.

    Raises:
        OptionRefused: another engine than the default was asked for.
    """
    if engine != "sat":
        raise OptionRefused(f"several snapshots have an engine of their own: leave out --engine {engine}")
    return rank(diagnose_snapshots(cnf, snapshots, options), cnf, options)


REFUSED = '{"error":'
"""How the line of a refused set begins."""


def options_for(system: System, options: Options) -> Options:
    """Return the options, their components checked against the model.

    Raises:
        UnknownComponent: what-if of something that the model does not have.
    """
    known = frozenset(system.cnf.components)
    names = {name: name.lstrip("/") or name for name in options.healthy | options.abnormal}
    for name in names.values():
        if name not in known:
            raise UnknownComponent(name, known)
    healthy = frozenset(names[name] for name in options.healthy)
    abnormal = frozenset(names[name] for name in options.abnormal)
    if healthy & abnormal:
        both = ", ".join(sorted(healthy & abnormal))
        raise InputError(f"{both} cannot be assumed healthy and abnormal at once")
    return replace(options, healthy=healthy, abnormal=abnormal)


def sentences_of(line: str) -> list[str]:
    """Return the sentences of one line: a JSON array of them, or sentences with commas or nothing between
    them."""
    stripped = line.strip()
    if stripped.startswith("["):
        try:
            found = json.loads(stripped)
        except (ValueError, RecursionError) as error:
            position = getattr(error, "pos", 0)
            raise ObservationError(f"not a JSON array: {error}", stripped[:200], position) from error
        return list(found)
    return _literals_of(stripped)


def _literals_of(line: str) -> list[str]:
    """Cut `v(1) not v(2), v(3)` into literals; what holds an `and`, `or` or arrow is one sentence."""
    from robomend.model.sentences import MAX_LENGTH, tokens

    if not line:
        return []
    if len(line) > MAX_LENGTH:
        raise ObservationError(f"more than {MAX_LENGTH} characters: write it as a JSON array", line[:80])
    found = tokens(line)
    if any(token.kind in ("and", "or", "->", "<->", "forall", "exists") for token in found):
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


def lines_of(path: str) -> Iterator[str]:
    """Yield the lines of a file that say something, `-` for stdin.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        if path == "-":
            yield from (line for line in sys.stdin if line.strip())
        else:
            with Path(path).open(encoding="utf-8") as file:
                yield from (line for line in file if line.strip())
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text") from error
