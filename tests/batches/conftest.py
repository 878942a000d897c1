"""A service that diagnoses logs, in the test's process, and as a process of its own."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, Service, running, start
from tests.waiting import until

from robomend.settings import Settings

SECOND = 1_000_000_000
ENDS = ("done", "failed", "cancelled")


def log_text(*said: str) -> str:
    """Return a log with a literal each second."""
    lines = [json.dumps({"time": number * SECOND, "literal": one}) for number, one in enumerate(said, 1)]
    return "\n".join(lines) + "\n"


SCAN = log_text("ok(scan)", "not ok(scan)", "ok(scan)")


def form(*logs: tuple[str, str | bytes], **fields: str) -> dict[str, Any]:
    """Return the options of a request that uploads logs."""
    return {"files": [("logs", (name, text)) for name, text in logs], "data": {"model": "tedusar", **fields}}


def left(service: Service) -> list[str]:
    """Return the folders of batches."""
    root = service.runtime.settings.data / "batches"
    return sorted(path.name for path in root.iterdir() if path.is_dir()) if root.exists() else []


def ended(service: Service, batch: str) -> dict[str, Any]:
    """Wait for the end of a batch and return it."""
    seen: dict[str, Any] = {}

    def over() -> bool:
        seen.update(service.api("GET", f"/batches/{batch}").json())
        return seen["state"] in ENDS

    until(over, f"the batch ends: {seen}", 300)
    return seen


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of logs, with a link that leads out of it beside one that does not."""
    root = tmp_path_factory.mktemp("batch")
    outside, folder = root / "outside", root / "logs"
    (folder / "night").mkdir(parents=True)
    outside.mkdir()
    (outside / "secret.ndjson").write_text(SCAN)
    (folder / "night" / "a.ndjson").write_text(SCAN)
    (folder / "night" / "b.csv").write_text("time,literal\n1000000000,not ok(odom)\n2000000000,ok(odom)\n")
    (folder / "night" / "notes.txt").write_text("no log")
    (folder / "polars.py").write_text(f"open({str(outside / 'run')!r}, 'w')\n")
    (folder / "in.ndjson").symlink_to(folder / "night" / "a.ndjson")
    (folder / "out.ndjson").symlink_to(outside / "secret.ndjson")
    (folder / "away").symlink_to(outside)
    return folder


@pytest.fixture(scope="module")
def batching(tmp_path_factory: pytest.TempPathFactory, logs: Path) -> Iterator[Service]:
    """A service with a model and a folder of logs."""
    data = tmp_path_factory.mktemp("data")
    small = {"max_batch_bytes": 1 << 20, "max_model_bytes": 500 << 10}
    with running(Settings(port=0, data=data, batch_folder=logs, batch_nice=0, **small)) as service:
        service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
        yield service


__all__ = ["batching", "logs", "start"]
