"""The services of these tests are forked from a process that has loaded their code."""

from __future__ import annotations

import pytest
from tests.forked import at_once

from robomend_bench.service import process


@pytest.fixture(autouse=True)
def _services_begin_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    at_once(monkeypatch, process)
