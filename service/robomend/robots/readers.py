"""What somebody sent is read in worker processes: models, richer observations, PDDL domains.

    text ──► counted (robomend.model.budget) ──► read and compiled ──► packed ──► the service
                   │ too many steps                    │ deadline, memory: the process is ended
                   └──► refused, with what it takes    └──► WorkerTimeout, WorkerDied

Reading is Python, and a second of it would keep the event loop from a stop for a second; in a thread it would
take the interpreter from the loop again and again. What is known to be done in a few milliseconds needs no
process: a short model without quantifiers and a repair domain are read in a thread, a short sentence at once.

Those who only ask (one-shots) never have all the processes: one is left for what robots and operators send.
"""

from __future__ import annotations

import asyncio
import hashlib
import re
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from typing import TypeVar, TypeVarTuple

from robomend.diagnosis.result import Options
from robomend.errors import Overloaded, RobomendError, TooLarge
from robomend.memory_limits import memory_unlimited
from robomend.model.budget import check_steps
from robomend.model.checking import contradictory, unblamable
from robomend.model.clauses import Assertion
from robomend.model.components import ComponentModel
from robomend.model.loading import load_text
from robomend.model.packed import packed, packed_assertion
from robomend.model.system import System
from robomend.model.vocabulary import Vocabulary
from robomend.observations.language import Unknown, read, read_assertion
from robomend.oneshots.warm_model import PackedQuestion, supposing, together
from robomend.planning.domain.loading import load_domain
from robomend.planning.problem import MEND
from robomend.settings import Settings
from robomend.workers.pool import WorkerPool
from robomend_client.literals import Literal

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

SHORT_MODEL = 2_500
"""Characters of a model without quantifiers that is read in a thread: some 3 ms, 12 the first time."""

SHORT_SENTENCE = 400
"""Characters of a richer sentence without quantifiers that is read at once: under a millisecond."""

SHORT_DOMAIN = 20_000
"""Characters of a repair domain that is read in a thread: some 15 ms."""

QUANTIFIER = re.compile(r"forall|exists|∀|∃")

LOOKED_AT = 50_000
"""Clauses of a model that is looked at for rules which contradict one another; `model check` looks at all."""

CONFLICTS = 1_000
"""Of each search for them: some milliseconds."""

MEMORY_BYTES = 3 << 30
"""Address space of a worker: a text that needs more ends its worker."""

NICENESS = 10
"""Of the workers: whoever may ask sends texts, and no robot's repair waits for one to be read."""

VOCABULARIES = 16
"""Kept in each worker, for sentences."""

DOMAINS = 256
"""Of which the actions' names are kept."""


@dataclass(frozen=True, slots=True)
class ModelLimits:
    """What a model may come to."""

    steps: int
    components: int
    clauses: int


class Readers:
    """See the module. Belongs to one event loop."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._limits = ModelLimits(settings.max_model_steps, settings.max_components, settings.max_clauses)
        self.pool = WorkerPool(
            "reader",
            size=settings.reader_workers,
            spare=0,
            warm=warm,
            memory_bytes=MEMORY_BYTES,
            queue_limit=64 + settings.one_shots,
            niceness=NICENESS,
        )
        self._guests = asyncio.Semaphore(max(1, settings.reader_workers - 1))
        self._asking = 0
        self._actions: OrderedDict[str, tuple[str, ...]] = OrderedDict()
        self._at_once = memory_unlimited()

    async def close(self) -> None:
        """End the processes."""
        await self.pool.aclose()

    async def model(
        self, source: str, *, name: str | None, format: str | None, guest: bool = False
    ) -> System:
        """Return the system description in a text, with the warnings that its rules contradict one another
        and that no rule can blame a component.

        Such a model is taken all the same: it is well-formed, and one that cannot be healthy may be meant.

        Args:
            guest: it is somebody's who only asks.

        Raises:
            ModelError: with the place and what is allowed.
            TooLarge: more bytes, components or clauses than the settings allow.
            WorkerTimeout, WorkerDied, Overloaded: see robomend.workers.pool.
        """
        self._check_size(source)
        if self.at_once(source):
            return await asyncio.to_thread(read_model, source, name, format, self._limits)
        async with self._turn(guest):
            system = await self.pool.run(
                read_model, source, name, format, self._limits, timeout_s=self._settings.reading_timeout_s
            )
        await asyncio.to_thread(system.vocabulary.prepare)
        return system

    async def question(self, source: str, sentences: Sequence[str], options: Options) -> PackedQuestion:
        """Return a question about a model's text, of somebody who only asks; for OneShots.answer.

        Raises:
            ObservationError: a sentence cannot be read, or all together take too many steps.
            UnknownComponent: what-if of something that the model does not have.
            InputError: two sentences, or what is supposed, contradict one another.
            ModelError, TooLarge, WorkerTimeout, WorkerDied, Overloaded: as `model` does.
        """
        self._check_size(source)
        timeout_s, most = self._settings.reading_timeout_s, self._settings.max_assertion_steps
        async with self._turn(guest=True):
            return await self.pool.run(
                read_question, source, sentences, options, self._limits, most, timeout_s=timeout_s
            )

    def at_once(self, source: str) -> bool:
        """Return whether a model is read without a worker: a short text without quantifiers."""
        return self._at_once and len(source) <= SHORT_MODEL and not QUANTIFIER.search(source)

    def _check_size(self, source: str) -> None:
        size, most = len(source.encode()), self._settings.max_model_bytes
        if size > most:
            raise TooLarge(f"the model has {size} bytes; max_model_bytes is {most}")

    async def assertion(
        self,
        key: str,
        vocabulary: Vocabulary,
        name: str,
        sentence: str,
        *,
        unknown: Unknown = "refuse",
        guest: bool = False,
    ) -> Assertion:
        """Return a sentence as an assertion; see robomend.observations.language.read_assertion.

        Args:
            key: names the vocabulary, which goes to a worker once.
        """
        most = self._settings.max_assertion_steps
        if len(sentence) <= SHORT_SENTENCE and not QUANTIFIER.search(sentence):
            return read_assertion(name, sentence, vocabulary, unknown=unknown, most=most)
        timeout_s = self._settings.reading_timeout_s
        async with self._turn(guest):
            try:
                return await self.pool.run(
                    read_sentence, key, None, name, sentence, unknown, most, timeout_s=timeout_s
                )
            except VocabularyMissing:
                return await self.pool.run(
                    read_sentence, key, vocabulary, name, sentence, unknown, most, timeout_s=timeout_s
                )

    async def actions(self, domain: str | None, parts: ComponentModel | None) -> tuple[str, ...]:
        """Return the names of what may be done to a robot: the actions of its repair domain, and its model's
        remedies; DomainError if it is no domain.
        """
        found = await self._actions_of(domain)
        remedies = () if parts is None or MEND not in found else (one.name for one in parts.remedies)
        return tuple(dict.fromkeys((*(name for name in found if name != MEND), *remedies)))

    async def _actions_of(self, domain: str | None) -> tuple[str, ...]:
        if domain is None or not domain.strip():
            return action_names(None)  # the one that is shipped, read once
        key = domain
        found = self._actions.get(key)
        if found is None:
            if len(domain) <= SHORT_DOMAIN:  # a repair waits for it
                found = await asyncio.to_thread(action_names, domain)
            else:
                timeout_s = self._settings.reading_timeout_s
                found = await self.pool.run(action_names, domain, timeout_s=timeout_s)
            self._actions[key] = found
            while len(self._actions) > DOMAINS:
                self._actions.popitem(last=False)
        self._actions.move_to_end(key)
        return found

    async def call(self, function: Callable[[*Ts], T], *arguments: *Ts) -> T:
        """Return what a function of a worker's returns."""
        return await self.pool.run(function, *arguments, timeout_s=self._settings.reading_timeout_s)

    @asynccontextmanager
    async def _turn(self, guest: bool) -> AsyncIterator[None]:
        """Wait for a process that guests may have; Overloaded when too many wait."""
        if not guest:
            yield
            return
        if self._asking >= self._settings.one_shots:
            raise Overloaded("too many one-shots wait for a reader already; try again later")
        self._asking += 1
        try:
            async with self._guests:
                yield
        finally:
            self._asking -= 1


# --- in the worker process ---


class VocabularyMissing(RobomendError):
    """The worker does not have this vocabulary: send it. Never leaves this module."""

    code = "vocabulary-missing"


_vocabularies: OrderedDict[str, Vocabulary] = OrderedDict()


def warm() -> None:
    """Import what the first call needs."""
    read_model("robomend: 1\nname: warm\nnodes: [n]\nrules: ['forall n in nodes: running(n)']", None, None)


def read_model(
    source: str, name: str | None, format: str | None, limits: ModelLimits | None = None
) -> System:
    """Return the system description in a text, packed where it is large."""
    if limits is None:
        system = load_text(source, name=name, format=format)
    else:
        system = load_text(source, name=name, format=format, most=limits.steps)
        for what, count, limit in (
            ("components", len(system.cnf.components), limits.components),
            ("clauses", len(system.cnf.clauses), limits.clauses),
        ):
            if count > limit:
                raise TooLarge(f"the model has {count} {what}; max_{what} is {limit}")
    doubts: tuple[str, ...] = ()
    if len(system.cnf.clauses) <= LOOKED_AT:
        doubts = (*contradictory(system, CONFLICTS), *unblamable(system))
    return replace(system, cnf=packed(system.cnf), warnings=(*system.warnings, *doubts))


def read_question(
    source: str, sentences: Sequence[str], options: Options, limits: ModelLimits, most: int
) -> PackedQuestion:
    """Return a question about a model's text: read, and packed for whoever answers it."""
    system = read_model(source, None, None, limits)
    spoken: list[Literal] = []
    assertions: list[Assertion] = []
    steps = 0
    for sentence in sentences:
        said = read(sentence, system.vocabulary, name=sentence, most=most)
        if isinstance(said, Assertion):
            steps += said.steps
            check_steps(steps, most, sentence)
            assertions.append(said)
        else:
            spoken += said
    asked = together(spoken, assertions, opposites="refuse")
    version = f"text:{hashlib.sha256(source.encode()).hexdigest()}"
    return PackedQuestion.of(version, system, asked, supposing(options, system))


def read_sentence(
    key: str, vocabulary: Vocabulary | None, name: str, sentence: str, unknown: Unknown, most: int
) -> Assertion:
    """Return a sentence as an assertion, packed where it is large."""
    known = _vocabularies.get(key)
    if known is None:
        if vocabulary is None:
            raise VocabularyMissing(key)
        known = _vocabularies[key] = vocabulary
        while len(_vocabularies) > VOCABULARIES:
            _vocabularies.popitem(last=False)
    _vocabularies.move_to_end(key)
    return packed_assertion(read_assertion(name, sentence, known, unknown=unknown, most=most))


def action_names(domain: str | None) -> tuple[str, ...]:
    """Return the names of a repair domain's actions."""
    return tuple(load_domain(domain, "domain").schemas)
