"""`robomend doctor`: what it says of the database."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path

import pytest

from robomend.cli.commands import run
from robomend.store import Store

pytestmark = pytest.mark.anyio


async def said_of_the_database(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the finding on the database, asked in another event loop, as another process would."""
    await asyncio.to_thread(run, ["doctor", "--data", str(folder), "--format", "json"])
    checks = json.loads(capsys.readouterr().out)["checks"]
    [detail] = [check["detail"] for check in checks if check["name"] == "database"]
    return str(detail)


async def test_the_database_is_named_with_the_services_that_use_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(f"sqlite:///{tmp_path}/robomend.db")
    await store.start()
    async with asyncio.timeout(5):
        while not await store.ownership.instances():
            await asyncio.sleep(0.01)
    assert f"(process {os.getpid()})" in await said_of_the_database(tmp_path, capsys)
    await store.close()
    assert "used by" not in await said_of_the_database(tmp_path, capsys)
