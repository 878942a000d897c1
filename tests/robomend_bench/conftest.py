"""What the bench starts is forked from a process that has loaded its code: services and contenders."""

from __future__ import annotations

import multiprocessing

import pytest
from tests.forked import at_once

from robomend_bench import worker
from robomend_bench.service import process

multiprocessing.set_forkserver_preload(
    ["robomend_bench.worker", "robomend_bench.contenders", "robomend.diagnosis.sat", "robomend.diagnosis.asp"]
)


@pytest.fixture(autouse=True)
def _what_is_started_begins_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    at_once(monkeypatch, process)
    monkeypatch.setattr(worker, "START_METHOD", "forkserver")
