"""Models and their versions."""

from __future__ import annotations

import hashlib

from sqlalchemy import select

from robomend.errors import NotFound, StateConflict
from robomend.store import schema
from robomend.store.encoding import checked
from robomend.store.records import ANY, FIRST_PAGE, Page, Paging, StoredModel
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction, check_seen

_VERSIONS, _MODELS = schema.model_versions, schema.models
_IS_CURRENT = (_MODELS.c.name == _VERSIONS.c.name) & (_MODELS.c.current == _VERSIONS.c.number)


def get(view: View, name: str, version: str | None = None) -> StoredModel:
    """Return the current version of a model, or the one named."""
    query = select(_VERSIONS).where(_VERSIONS.c.name == checked(name))
    if version is None:
        return _model(view.one(query.join(_MODELS, _IS_CURRENT), f"model {name!r}"))
    query = query.where(_VERSIONS.c.version == checked(version)).order_by(_VERSIONS.c.number.desc())
    return _model(view.one(query, f"version {version!r} of a model {name!r}"))


def find(view: View, name: str) -> StoredModel | None:
    """Return the current version of a model, if there is one."""
    query = select(_VERSIONS).where(_VERSIONS.c.name == checked(name)).join(_MODELS, _IS_CURRENT)
    row = view.first(query)
    return None if row is None else _model(row)


def page(view: View, paging: Paging = FIRST_PAGE) -> Page[StoredModel]:
    """Return the current versions, by name."""
    return view.by_name(select(_VERSIONS).join(_MODELS, _IS_CURRENT), _model, paging, "name")


def versions(view: View, name: str, paging: Paging = FIRST_PAGE) -> Page[StoredModel]:
    """Return all versions of a model, newest first."""
    get(view, name)
    return view.newest_first(_VERSIONS, _model, paging, _VERSIONS.c.name == name)


def put(
    tx: Transaction, name: str, source: str, *, format: str, by: str, expected: str | None
) -> StoredModel:
    """Add a version and make it the current one; the text that it already has adds none.

    `expected`: see `check_seen` (transaction.py).
    """
    current = _locked(tx, name)
    digest = hashlib.sha256(f"{checked(format)}\n{checked(source)}".encode()).hexdigest()[:20]
    check_seen(f"model {name!r}", expected, current.version if current else None, wanted=digest)
    if current is not None and current.version == digest:
        return current
    number = current.number + 1 if current else 1
    model = StoredModel(name, digest, number, format, source, tx.now_ns, checked(by))
    row = {"name": name, "number": number, "version": digest, "format": format, "source": source}
    tx.change(_VERSIONS.insert(), row | {"created_ns": tx.now_ns, "by": by})
    tx.replace(_MODELS, {"name": name, "current": number})
    return model


def delete(tx: Transaction, name: str, *, expected: str | None = ANY) -> None:
    """Delete a model with all versions. StateConflict while a robot follows it."""
    current = _locked(tx, name)
    if current is None:
        raise NotFound(f"there is no model {name!r}")
    check_seen(f"model {name!r}", expected, current.version)
    follower = tx.first(select(schema.robots.c.id).where(schema.robots.c.model == name))
    if follower is not None:
        raise StateConflict(f"robot {follower.id!r} follows the model {name!r}; give it another one first")
    tx.change(_MODELS.delete().where(_MODELS.c.name == name))
    tx.change(_VERSIONS.delete().where(_VERSIONS.c.name == name))


def _locked(tx: Transaction, name: str) -> StoredModel | None:
    if tx.first(select(_MODELS).where(_MODELS.c.name == checked(name)).with_for_update()) is None:
        return None
    return get(tx, name)


def _model(row: AnyRow) -> StoredModel:
    return StoredModel(row.name, row.version, row.number, row.format, row.source, row.created_ns, row.by)
