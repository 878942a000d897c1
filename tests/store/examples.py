"""What the tests of the store put into it."""

from __future__ import annotations

from sqlalchemy import select

from robomend.entry import Entry
from robomend.store import Store, Transaction, View, journal, models, observations, robots, schema
from robomend.store.records import Intent
from robomend_client.literals import Atom, Literal


def entry(
    name: str,
    positive: bool = True,
    *,
    time_ns: int = 1,
    source: str = "general",
    expires_ns: int | None = None,
) -> Entry:
    """Return `ok(name)` or its negation."""
    return Entry(Literal(Atom("ok", (name,)), positive), source, time_ns, expires_ns)


def intents(view: View, repair: str) -> tuple[Intent, ...]:
    """Return the journal of a repair."""
    table = schema.journal
    rows = view.rows(select(table.c.id).where(table.c.repair == repair).order_by(table.c.number))
    return tuple(journal.get(view, row.id) for row in rows)


def owner(view: View, robot: str) -> tuple[str | None, int]:
    """Return the instance that owned the robot last, None if it let it go, and its fencing number."""
    table = schema.robot_state
    row = view.one(select(table).where(table.c.robot == robot), "state")
    return row.owner, row.fence


async def with_robots(store: Store, *names: str) -> None:
    """Add a model and robots that follow it."""

    def add(tx: Transaction) -> None:
        if not models.page(tx).items:
            models.put(tx, "tedusar", "robomend: 1", format="component", by="test", expected=None)
        for robot in names:
            robots.put(tx, robot, {"model": "tedusar"}, expected=None)

    await store.write(add)


async def observe(store: Store, robot: str, *entries: Entry, expected: int | None = None) -> int:
    """Accept a batch, and return the revision."""
    return await store.write(
        lambda tx: observations.observe(tx, robot, accepted=entries, changed=entries, expected=expected),
        robots=(robot,),
    )
