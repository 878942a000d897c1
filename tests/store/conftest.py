"""Every test of the store runs on SQLite and on PostgreSQL."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from tests.postgres import postgres_server, postgres_url

from robomend.store import Store

__all__ = ["postgres_server", "postgres_url"]  # fixtures


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An empty database of either kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/robomend.db"
    return str(request.getfixturevalue("postgres_url"))


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
