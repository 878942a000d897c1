"""What is there for threads is made from what is there for asyncio."""

from __future__ import annotations

import shutil
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


def test_one_that_was_changed_by_hand_is_named(tmp_path: Path) -> None:
    clients = Path(shutil.copytree(CLIENTS, tmp_path / "clients"))
    shutil.copy(CLIENTS.parent / "pyproject.toml", tmp_path)  # the formatter's line length
    made = clients / "robomend_client" / "outbox" / "sync.py"
    made.write_text(made.read_text().replace("return True", "return False", 1))
    done = checked(clients)
    assert (done.returncode, done.stdout) == (1, "clients/robomend_client/outbox/sync.py\n")
