"""Here workers are what they are for users: fresh interpreters."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator

import pytest

from robomend.workers import process


@pytest.fixture(scope="module", autouse=True)
def workers_from_nothing() -> Iterator[None]:
    """Start workers as the service does; other tests have them forked (tests/forked.py)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process, "subprocess", subprocess)
        yield
