"""The rover whose recordings are diagnosed."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.robomend_batch.rover import MODEL, OBSERVERS


@pytest.fixture
def rover(tmp_path: Path) -> tuple[Path, Path]:
    """Its model and its observers, as files."""
    model, observers = tmp_path / "rover.yaml", tmp_path / "agent.yaml"
    model.write_text(MODEL)
    observers.write_text(OBSERVERS)
    return model, observers
