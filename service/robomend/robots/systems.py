"""The model server: models as versioned texts in the store, compiled once per version for all robots.

A bad model is refused whole, before anything is written. A new version reaches the robots that follow it
through `on_change`: they are diagnosed anew over the same OBS.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace

from robomend.errors import InputError, TooLarge
from robomend.model.checking import contradictory
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend.oneshots.oneshots import Subject
from robomend.settings import Settings
from robomend.store import Store, Transaction, models
from robomend.store.records import AuditEntry, StoredModel
from robomend_client.events import Kind

KEPT = 256
"""Compiled versions kept; those that a robot uses live on with the robot."""

SHORT = 20_000
"""Characters that are compiled on the event loop: a few milliseconds, less than a thread's turn."""

LOOKED_AT = 50_000
"""Clauses of a model that is looked at for rules which contradict one another; `model check` looks at all."""

CONFLICTS = 1_000
"""Of each search for them: some milliseconds."""


class Systems:
    """See the module. Belongs to one event loop."""

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store = store
        self._settings = settings
        self._compiled: OrderedDict[tuple[str, str], System] = OrderedDict()
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
        system = self._compiled.get(key)
        if system is None:
            system = await self._looked_at(
                await self.load(model.source, name=model.name, format=model.format)
            )
            self._keep(key, system)
        else:
            self._compiled.move_to_end(key)
        return system

    async def subject(self, model: str | None, source: str | None) -> Subject:
        """Return what a one-shot asks about: a stored model by its name, or a model's text.

        Raises:
            InputError: neither, or both.
            NotFound: there is no model of this name.
            ModelError, TooLarge: as `load`.
        """
        if (model is None) == (source is None):
            raise InputError("give either `model`, the name of a stored one, or `source`, a model's text")
        if model is not None:
            stored, system = await self.current(model)
            return Subject(f"{stored.name}@{stored.version}", system)
        assert source is not None
        system = await self.load(source, name=None, format=None)
        return Subject(f"text:{hashlib.sha256(source.encode()).hexdigest()}", system)

    async def load(self, source: str, *, name: str | None, format: str | None) -> System:
        """Compile a text within the service's limits.

        Raises:
            ModelError: with the place and what is allowed.
            TooLarge: more bytes, components or clauses than the settings allow.
        """
        size = len(source.encode())
        most = self._settings.max_model_bytes
        if size > most:
            raise TooLarge(f"the model has {size} bytes; max_model_bytes is {most}")
        if len(source) <= SHORT:
            system = load_text(source, name=name, format=format)
        else:
            system = await asyncio.to_thread(load_text, source, name=name, format=format)
        for what, count, limit in (
            ("components", len(system.cnf.components), self._settings.max_components),
            ("clauses", len(system.cnf.clauses), self._settings.max_clauses),
        ):
            if count > limit:
                raise TooLarge(f"the model has {count} {what}; max_{what} is {limit}")
        return system

    async def _looked_at(self, system: System) -> System:
        """Add the warning that the rules contradict one another, in the words of `model check`.

        Such a model is taken all the same: it is well-formed, and one that cannot be healthy may be meant.
        """
        if len(system.cnf.clauses) > LOOKED_AT:
            return system
        if len(system.source) <= SHORT:
            clash = tuple(contradictory(system, CONFLICTS))
        else:
            clash = await asyncio.to_thread(lambda: tuple(contradictory(system, CONFLICTS)))
        return replace(system, warnings=(*system.warnings, *clash)) if clash else system

    async def put(
        self, name: str, source: str, *, format: str | None, expected: str | None, by: str
    ) -> tuple[StoredModel, System]:
        """Check a model and add it as a new version.

        Raises:
            ModelError: it is none; the version before stays.
            PreconditionRequired, PreconditionFailed: see store.preconditions.
        """
        system = await self._looked_at(await self.load(source, name=name, format=format))

        def put(tx: Transaction) -> StoredModel:
            model = models.put(tx, name, source, format=system.format, by=by, expected=expected)
            tx.emit(Kind.MODEL, None, {"name": name, "version": model.version, "number": model.number})
            tx.note(AuditEntry(actor=by, action="model.put", subject=name, after={"version": model.version}))
            return model

        model = await self._store.write(put)
        self._keep((name, model.version), system)
        for callback in self._on_change:
            callback(name)
        return model, system

    async def delete(self, name: str, *, expected: str, by: str) -> None:
        """Delete a model; Conflict while a robot follows it."""

        def delete(tx: Transaction) -> None:
            models.delete(tx, name, expected=expected)
            tx.emit(Kind.MODEL, None, {"name": name, "version": None})
            tx.note(AuditEntry(actor=by, action="model.delete", subject=name))

        await self._store.write(delete)

    def _keep(self, key: tuple[str, str], system: System) -> None:
        self._compiled[key] = system
        self._compiled.move_to_end(key)
        while len(self._compiled) > KEPT:
            self._compiled.popitem(last=False)
