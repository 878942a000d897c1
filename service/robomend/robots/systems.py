"""The model server: models as versioned texts in the store, compiled once per version for all robots.

A bad model is refused whole, before anything is written. A new version reaches the robots that follow it
through `on_change`: they are diagnosed anew over the same OBS.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence

from robomend.errors import InputError
from robomend.model.budget import check_steps
from robomend.model.clauses import Assertion
from robomend.model.system import System
from robomend.observations.language import parse, says_literals
from robomend.oneshots.oneshots import Subject
from robomend.oneshots.warm_model import Question, together
from robomend.robots.readers import Readers
from robomend.settings import Settings
from robomend.store import Store, Transaction, models
from robomend.store.records import AuditEntry, StoredModel
from robomend.yielding import Turns
from robomend_client.events import Kind
from robomend_client.literals import Literal

KEPT = 256
"""Compiled versions kept; those that a robot uses live on with the robot."""


class Systems:
    """See the module. Belongs to one event loop."""

    def __init__(self, store: Store, settings: Settings, readers: Readers) -> None:
        self._store = store
        self._settings = settings
        self.readers = readers
        self._compiled: OrderedDict[tuple[str, str], System] = OrderedDict()
        self._reading: dict[tuple[str, str], asyncio.Lock] = {}  # one reads a version, others wait for it
        self._on_change: list[Callable[[str], None]] = []

    def on_change(self, callback: Callable[[str], None]) -> None:
        """Call back with a model's name after this instance gave it a new version."""
        self._on_change.append(callback)

    async def current(self, name: str) -> tuple[StoredModel, System]:
        """Return a model's current version; NotFound."""
        model = await self._store.read(models.get, name)
        return model, await self.compiled(model)

    async def compiled(self, model: StoredModel) -> System:
        """Return the system of a stored version."""
        key = (model.name, model.version)
        if (system := self._compiled.get(key)) is not None:
            self._compiled.move_to_end(key)
            return system
        async with self._reading.setdefault(key, asyncio.Lock()):
            try:
                if (system := self._compiled.get(key)) is None:
                    system = await self.readers.model(model.source, name=model.name, format=model.format)
                    self._keep(key, system)
            finally:
                self._reading.pop(key, None)
        return system

    async def subject(self, model: str | None, source: str | None) -> Subject:
        """Return what a one-shot asks about: a stored model by its name, or a model's text.

        Raises:
            InputError: neither, or both.
            NotFound: there is no model of this name.
            ModelError, TooLarge, Overloaded: see Readers.model.
        """
        if (model is None) == (source is None):
            raise InputError("give either `model`, the name of a stored one, or `source`, a model's text")
        if model is not None:
            stored, system = await self.current(model)
            return Subject(f"{stored.name}@{stored.version}", system)
        assert source is not None
        system = await self.readers.model(source, name=None, format=None, guest=True)
        return Subject(f"text:{hashlib.sha256(source.encode()).hexdigest()}", system)

    async def question(self, subject: Subject, sentences: Sequence[str]) -> Question:
        """Return what a one-shot's sentences say, all of one moment; see robomend.oneshots.warm_model.

        Raises:
            ObservationError: a sentence cannot be read, or all together take too many steps.
            InputError: two contradict one another.
            Overloaded: too many one-shots wait for a reader.
        """
        spoken: list[Literal] = []
        assertions: list[Assertion] = []
        vocabulary = subject.system.vocabulary
        turns, steps = Turns(), 0
        for sentence in sentences:
            if says_literals(sentence, vocabulary):
                spoken += parse(sentence, vocabulary)
            else:
                said = await self.readers.assertion(
                    subject.version, vocabulary, sentence, sentence, guest=True
                )
                steps += said.steps
                check_steps(steps, self._settings.max_assertion_steps, sentence)
                assertions.append(said)
            await turns.rest()
        return together(spoken, assertions, opposites="refuse")

    async def put(
        self,
        name: str,
        source: str,
        *,
        format: str | None,
        expected: str | None,
        by: str,
        reason: str = "",
    ) -> tuple[StoredModel, System]:
        """Check a model and add it as a new version.

        Raises:
            ModelError: it is none; the version before stays.
            PreconditionRequired, PreconditionFailed: see store.preconditions.
        """
        system = await self.readers.model(source, name=name, format=format)

        def put(tx: Transaction) -> tuple[StoredModel, bool]:
            known = models.find(tx, name)
            model = models.put(tx, name, source, format=system.format, by=by, expected=expected)
            if known is not None and known.version == model.version:
                return model, False
            tx.emit(Kind.MODEL, None, {"name": name, "version": model.version, "number": model.number})
            after = {"version": model.version}
            tx.note(AuditEntry(by, "model.put", name, None, reason, after=after))
            return model, True

        model, changed = await self._store.write(put)
        self._keep((name, model.version), system)
        for callback in self._on_change if changed else ():
            callback(name)
        return model, system

    async def delete(self, name: str, *, expected: str, by: str, reason: str = "") -> None:
        """Delete a model; Conflict while a robot follows it."""

        def delete(tx: Transaction) -> None:
            models.delete(tx, name, expected=expected)
            tx.emit(Kind.MODEL, None, {"name": name, "version": None})
            tx.note(AuditEntry(by, "model.delete", name, None, reason))

        await self._store.write(delete)

    def _keep(self, key: tuple[str, str], system: System) -> None:
        self._compiled[key] = system
        self._compiled.move_to_end(key)
        while len(self._compiled) > KEPT:
            self._compiled.popitem(last=False)
