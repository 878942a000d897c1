"""Every test of the store runs on SQLite and on PostgreSQL."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from tests.postgres import empty_database, postgres_laid, postgres_server, postgres_url

from robomend.store import Store

__all__ = ["postgres_laid", "postgres_server", "postgres_url"]  # fixtures


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """An empty database of either kind; on PostgreSQL with the schema, where a test wants a started store."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path}/robomend.db"
    elif "store" in request.fixturenames:
        server, laid = (request.getfixturevalue(name) for name in ("postgres_server", "postgres_laid"))
        with empty_database(server, laid) as url:
            yield url
    else:
        yield request.getfixturevalue("postgres_url")


@pytest.fixture
async def store(url: str) -> AsyncIterator[Store]:
    """A started store in an empty database."""
    store = Store(url)
    await store.start()
    yield store
    await store.close()


@pytest.fixture
async def second(url: str, store: Store) -> AsyncIterator[Store]:
    """Another instance on the same database."""
    second = Store(url)
    await second.start()
    yield second
    await second.close()
