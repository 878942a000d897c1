"""Moments: freeze frames of faults, and the recordings beside them, in pieces.

A moment comes in whole, again whole when its agent has more to say of it, and its recording piece by piece,
each behind the last: what came twice changes nothing. Room is made by forgetting the oldest moments, of the
robot that has more than its number, or of the one that takes most where all take more than their bytes. The
pieces of what is forgotten are removed by pruning.py, a few at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from zlib import decompress

from sqlalchemy import func, select

from robomend.errors import InputError, StateConflict
from robomend.store import schema
from robomend.store.encoding import checked, checked_ns, from_json, to_json
from robomend.store.records import FIRST_PAGE, Json, MomentBounds, Page, Paging, StoredMoment
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction
from robomend_client.events import Kind

_MOMENTS = schema.moments
_PIECES = schema.moment_pieces

FRAME = -1
"""Where the frame stands among the pieces."""

AT_ONCE = 1000
"""Moments that are looked at together where room is made."""


def id_of(robot: str, agent: str, key: str) -> str:
    """Return the id of a moment that its agent calls by a key of its own."""
    return "m-" + sha256(to_json([robot, agent, key]).encode()).hexdigest()[:20]


def get(view: View, moment: str) -> StoredMoment:
    """Return a moment."""
    return _moment(view.one(select(_MOMENTS).where(_MOMENTS.c.id == checked(moment)), f"moment {moment!r}"))


def page(view: View, robot: str, paging: Paging = FIRST_PAGE) -> Page[StoredMoment]:
    """Return a robot's moments, newest first."""
    return view.newest_first(_MOMENTS, _moment, paging, _MOMENTS.c.robot == checked(robot))


def between(view: View, robot: str, first_ns: int, last_ns: int, most: int) -> tuple[StoredMoment, ...]:
    """Return the robot's moments that came within that time, the oldest first."""
    within = (_MOMENTS.c.created_ns >= first_ns) & (_MOMENTS.c.created_ns <= last_ns)
    query = select(_MOMENTS).where(_MOMENTS.c.robot == checked(robot), within)
    return tuple(map(_moment, view.rows(query.order_by(_MOMENTS.c.number).limit(most))))


def frame(view: View, moment: StoredMoment) -> Json:
    """Return the freeze frame of a moment; an empty one, where the moment is no more."""
    packed = piece(view, moment, FRAME)
    return from_json(decompress(packed).decode()) if packed else {}


def piece(view: View, moment: StoredMoment, at: int) -> bytes:
    """Return what of a recording begins at that byte; nothing, where it is not (or no more) there."""
    row = view.first(select(_PIECES.c.data).where(_PIECES.c.moment == moment.number, _PIECES.c.at == at))
    return b"" if row is None else bytes(row.data)


def keep(
    tx: Transaction,
    robot: str,
    *,
    agent: str,
    key: str,
    at_ns: int,
    literals: Sequence[Json],
    complete: bool,
    data: Json,
    board: Json,
    bounds: MomentBounds,
) -> StoredMoment:
    """Keep a moment, or what its agent has to add to it; one that is complete stays as it is.

    Args:
        data: its frame.
        board: what the power board shows, which is kept as it was when the moment first came.

    Raises:
        NotFound: there is no such robot.
    """
    tx.existing(robot)
    moment = id_of(robot, agent, key)
    before = tx.first(select(_MOMENTS).where(_MOMENTS.c.id == moment))
    if before is not None:
        if before.complete:
            return _moment(before)
        board = frame(tx, _moment(before)).get("board", board)
    packed = schema.packed(to_json({**data, "board": board}))
    values = {
        "at_ns": checked_ns(at_ns),
        "literals": to_json(list(literals)),
        "complete": complete,
        "bytes": len(packed) + ((before.size or 0) if before is not None else 0),
        "updated_ns": tx.now_ns,
    }
    if before is None:
        new = {"id": moment, "robot": robot, "agent": checked(agent), "have": 0, "created_ns": tx.now_ns}
        number = tx.insert(_MOMENTS, new | values)
    else:
        number = before.number
        tx.change(_MOMENTS.update().where(_MOMENTS.c.number == number).values(values))
        tx.change(_PIECES.delete().where(_PIECES.c.moment == number, _PIECES.c.at == FRAME))
    tx.insert(_PIECES, {"moment": number, "at": FRAME, "data": packed})
    _make_room(tx, robot, number, bounds)
    tx.emit(Kind.MOMENT, robot, {"moment": moment, "at_ns": at_ns, "complete": complete})
    return get(tx, moment)


def keep_piece(
    tx: Transaction, robot: str, moment: str, *, at: int, size: int, data: bytes, bounds: MomentBounds
) -> int:
    """Keep what of a recording of `size` bytes begins at that byte; return how much of it has come now.

    Raises:
        NotFound: the robot has no such moment.
        StateConflict: another size was said before.
        InputError: it goes beyond the recording's end.
    """
    tx.existing(robot)
    query = select(_MOMENTS).where(_MOMENTS.c.id == checked(moment), _MOMENTS.c.robot == robot)
    found = _moment(tx.one(query, f"moment {moment!r} of {robot!r}"))
    if found.size not in (None, size):
        raise StateConflict(f"the recording of moment {moment} has {found.size} bytes, not {size}")
    if at + len(data) > size:
        raise InputError(f"a piece of {len(data)} bytes at {at} goes beyond the {size} of its recording")
    if at != found.have or not data:
        return found.have
    values = {"have": at + len(data), "size": size, "updated_ns": tx.now_ns}
    if found.size is None:
        values["bytes"] = found.bytes + size
    tx.change(_MOMENTS.update().where(_MOMENTS.c.number == found.number).values(values))
    if found.size is None:
        _make_room(tx, robot, found.number, bounds)
    tx.insert(_PIECES, {"moment": found.number, "at": at, "data": data})
    if at + len(data) == size:
        tx.emit(Kind.MOMENT, robot, {"moment": moment, "at_ns": found.at_ns, "complete": found.complete})
    return at + len(data)


def _make_room(tx: Transaction, robot: str, newest: int, bounds: MomentBounds) -> None:
    """Forget the oldest moments, but never the one with this number."""
    number, of_robot = _MOMENTS.c.number, _MOMENTS.c.robot == robot
    kept = select(number).where(of_robot).order_by(number.desc())
    beyond = [row.number for row in tx.rows(kept.offset(bounds.of_robot).limit(AT_ONCE))]
    _forget(tx, [one for one in beyond if one != newest])
    over = _bytes(tx) - bounds.bytes
    while over > 0:
        total = func.sum(_MOMENTS.c.bytes)
        largest = select(_MOMENTS.c.robot).where(number != newest).group_by(_MOMENTS.c.robot)
        whose = tx.first(largest.order_by(total.desc(), _MOMENTS.c.robot))
        if whose is None:
            return
        oldest = select(number, _MOMENTS.c.bytes).where(_MOMENTS.c.robot == whose.robot, number != newest)
        row = tx.rows(oldest.order_by(number).limit(1))[0]
        _forget(tx, [row.number])
        over -= row.bytes


def _bytes(tx: Transaction) -> int:
    return int(tx.rows(select(func.coalesce(func.sum(_MOMENTS.c.bytes), 0)))[0][0])


def _forget(tx: Transaction, numbers: Sequence[int]) -> None:
    if numbers:
        tx.change(_MOMENTS.delete().where(_MOMENTS.c.number.in_(numbers)))


def _moment(row: AnyRow) -> StoredMoment:
    return StoredMoment(
        row.id,
        row.number,
        row.robot,
        row.agent,
        row.at_ns,
        tuple(from_json(row.literals)),
        row.complete,
        row.size,
        row.have,
        row.bytes,
        row.created_ns,
        row.updated_ns,
    )
