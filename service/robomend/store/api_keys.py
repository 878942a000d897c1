"""Bearer keys, and the browsers that are signed in with one."""

from __future__ import annotations

import time

from sqlalchemy import select

from robomend.errors import StateConflict
from robomend.store import schema
from robomend.store.encoding import checked, checked_ns, checked_or_none, new_id
from robomend.store.records import ApiKey, AuditEntry, SignIn
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction

_KEYS, _SIGN_INS = schema.api_keys, schema.sign_ins


def every(view: View) -> tuple[ApiKey, ...]:
    """Return all keys, revoked ones included, in the order of creation."""
    return tuple(_key(row) for row in view.rows(select(_KEYS).order_by(_KEYS.c.number)))


def add(tx: Transaction, *, name: str, hash: str, role: str, robot: str | None, by: str) -> ApiKey:
    """Keep a key. StateConflict if an unrevoked one has the name."""
    if tx.rows(select(_KEYS.c.id).where(_KEYS.c.name == checked(name), _KEYS.c.revoked_ns.is_(None))):
        raise StateConflict(f"there is a key named {name!r}; revoke it first, or take another name")
    key = ApiKey(new_id("k-"), name, checked(hash), role, robot, tx.now_ns, checked(by))
    tx.insert(
        _KEYS,
        {
            "id": key.id,
            "name": name,
            "hash": hash,
            "role": checked(role),
            "robot": checked_or_none(robot),
            "created_ns": tx.now_ns,
            "by": by,
            "revoked_ns": None,
        },
    )
    return key


def told(action: str, key: ApiKey, *, by: str, reason: str) -> AuditEntry:
    """Return what the audit log says of a key that is made or revoked; never its text."""
    after = {"id": key.id, "role": key.role, "robot": key.robot}
    return AuditEntry(by, action, key.name, key.robot, reason, after=after)


def revoke(tx: Transaction, key: str) -> ApiKey:
    """Revoke a key by its id, for good."""
    in_use = (_KEYS.c.id == checked(key)) & _KEYS.c.revoked_ns.is_(None)
    tx.change(_KEYS.update().where(in_use), {"revoked_ns": tx.now_ns})
    return _key(tx.one(select(_KEYS).where(_KEYS.c.id == key), f"key {key!r}"))


def sign_in(view: View, hash: str) -> SignIn | None:
    """Return a sign-in with its key, which may be revoked; None if there is none or its time is over."""
    until = _SIGN_INS.c.expires_ns.label("until_ns")
    since = _SIGN_INS.c.created_ns.label("since_ns")
    query = select(_KEYS, since, until).join(_SIGN_INS, _SIGN_INS.c.key == _KEYS.c.id)
    row = view.first(query.where(_SIGN_INS.c.hash == checked(hash), until > time.time_ns()))
    return None if row is None else SignIn(hash, _key(row), row.since_ns, row.until_ns)


def add_sign_in(tx: Transaction, hash: str, key: str, *, expires_ns: int, most: int) -> SignIn:
    """Keep a browser's sign-in with the key of this id, and forget those whose time is over.

    Beyond `most` of one key, the oldest is forgotten. NotFound if the key is revoked.
    """
    table = _SIGN_INS
    valid = select(_KEYS).where(_KEYS.c.id == checked(key), _KEYS.c.revoked_ns.is_(None))
    made = SignIn(checked(hash), _key(tx.one(valid, f"key {key!r}")), tx.now_ns, expires_ns)
    tx.change(table.delete().where(table.c.expires_ns <= tx.now_ns))
    of_key = select(table.c.hash).where(table.c.key == key).order_by(table.c.created_ns.desc())
    beyond = [row.hash for row in tx.rows(of_key.offset(most - 1))]
    if beyond:
        tx.change(table.delete().where(table.c.hash.in_(beyond)))
    row = {"hash": hash, "key": key, "created_ns": tx.now_ns, "expires_ns": checked_ns(expires_ns)}
    tx.change(table.insert(), row)
    return made


def end_sign_in(tx: Transaction, hash: str) -> None:
    """Forget a sign-in, if there is one."""
    tx.change(_SIGN_INS.delete().where(_SIGN_INS.c.hash == checked(hash)))


def _key(row: AnyRow) -> ApiKey:
    return ApiKey(row.id, row.name, row.hash, row.role, row.robot, row.created_ns, row.by, row.revoked_ns)
