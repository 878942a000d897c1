"""`robomend keys`: what the audit log has of it."""

from __future__ import annotations

import asyncio
import getpass
import subprocess
import sys
from pathlib import Path

import pytest

from robomend.cli.commands import run
from robomend.store import Store, audit


def test_keys_are_created_and_revoked_by_an_account_for_a_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = ["--data", str(tmp_path)]
    created = ["--role", "robot", "--robot", "r1", "--reason", "a new robot"]
    assert run(["keys", "create", *data, *created]) == 0
    assert run(["keys", "revoke", *data, "robot-r1", "--reason", "it was stolen"]) == 0
    assert "revoked" in capsys.readouterr().err

    async def log() -> list[tuple[str, str, str, str | None, str]]:
        store = Store(f"sqlite:///{tmp_path}/robomend.db")
        await store.start()
        entries = (await store.read(audit.page)).items
        await store.close()
        return [(entry.actor, entry.action, entry.subject, entry.robot, entry.reason) for entry in entries]

    who = f"command line ({getpass.getuser()})"
    assert asyncio.run(log()) == [
        (who, "key.revoke", "robot-r1", "r1", "it was stolen"),
        (who, "key.create", "robot-r1", "r1", "a new robot"),
    ]


def test_the_database_is_asked_without_the_service(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom robomend.cli.commands import run\n"
        f"assert run(['keys', 'list', '--data', {str(tmp_path)!r}]) == 0\n"
        "print(*sorted({'fastapi', 'robomend.api', 'robomend.repairs', 'sqlalchemy'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60
    )
    assert done.stdout.split() == ["sqlalchemy"]
