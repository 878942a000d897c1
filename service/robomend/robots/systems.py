"""The model server: models as versioned texts in the store, compiled once per version for all robots.

A bad model is refused whole, before anything is written. A new version reaches the robots that follow it
through `on_change`: they are diagnosed anew over the same OBS.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from robomend.model.system import System
from robomend.robots.readers import Readers
from robomend.store.interface import Store, Transaction
from robomend.store.records import AuditEntry, StoredModel
from robomend_client.events import Kind

KEPT = 256
"""Compiled versions kept; those that a robot uses live on with the robot."""


class Systems:
    """See the module. Belongs to one event loop."""

    def __init__(self, store: Store, readers: Readers) -> None:
        self._store = store
        self.readers = readers
        self._compiled: OrderedDict[tuple[str, str], System] = OrderedDict()
        self._on_change: list[Callable[[str], None]] = []

    def on_change(self, callback: Callable[[str], None]) -> None:
        """Call back with a model's name after this instance gave it a new version."""
        self._on_change.append(callback)

    async def current(self, name: str) -> tuple[StoredModel, System]:
        """Return a model's current version; NotFound."""
        model = await self._store.read(lambda view: view.model(name))
        return model, await self.compiled(model)

    async def compiled(self, model: StoredModel) -> System:
        """Return the system of a stored version."""
        key = (model.name, model.version)
        system = self._compiled.get(key)
        if system is None:
            system = await self.readers.model(model.source, name=model.name, format=model.format)
            self._keep(key, system)
        else:
            self._compiled.move_to_end(key)
        return system

    async def put(
        self, name: str, source: str, *, format: str | None, expected: str | None, by: str
    ) -> tuple[StoredModel, System]:
        """Check a model and add it as a new version.

        Raises:
            ModelError: it is none; the version before stays.
            PreconditionRequired, PreconditionFailed: see store.interface.
        """
        system = await self.readers.model(source, name=name, format=format)

        def put(tx: Transaction) -> StoredModel:
            model = tx.put_model(name, source, format=system.format, by=by, expected=expected)
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
            tx.delete_model(name, expected=expected)
            tx.emit(Kind.MODEL, None, {"name": name, "version": None})
            tx.note(AuditEntry(actor=by, action="model.delete", subject=name))

        await self._store.write(delete)

    def _keep(self, key: tuple[str, str], system: System) -> None:
        self._compiled[key] = system
        self._compiled.move_to_end(key)
        while len(self._compiled) > KEPT:
            self._compiled.popitem(last=False)
