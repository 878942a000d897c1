"""What is there for threads is made from what is there for asyncio."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("ruff", reason="the formatter comes with the tests of all of robomend")

CLIENTS = Path(__file__).resolve().parents[2] / "clients"


def checked(clients: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(clients / "make_sync.py"), "--check"]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_the_clients_for_threads_are_as_they_would_be_made_now() -> None:
    done = checked(CLIENTS)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), "run `./dev check --fix`"
