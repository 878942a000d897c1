"""What the tests of the store put into it."""

from __future__ import annotations

from collections.abc import Sequence

from robomend.entry import Entry
from robomend.store.interface import Store, Transaction
from robomend_client.events import Kind
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


async def with_robots(store: Store, *robots: str) -> None:
    """Add a model and robots that follow it."""

    def add(tx: Transaction) -> None:
        if not tx.models().items:
            tx.put_model("tedusar", "robomend: 1", format="component", by="test", expected=None)
        for robot in robots:
            tx.put_robot(robot, {"model": "tedusar"}, expected=None)

    await store.write(add)


async def observe(store: Store, robot: str, *entries: Entry, expected: int | None = None) -> int:
    """Accept a batch, with its event, and return the revision."""

    def accept(tx: Transaction) -> int:
        revision = tx.observe(robot, accepted=entries, changed=entries, expected=expected)
        tx.emit(Kind.OBSERVATIONS, robot, {"revision": revision, "changed": texts(entries)})
        return revision

    return await store.write(accept, robots=(robot,))


def texts(entries: Sequence[Entry]) -> list[str]:
    """Return the literals as they are written."""
    return [str(e.atom) if e.positive else f"not {e.atom}" for e in entries]
