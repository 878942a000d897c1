"""Options and fixtures that every room's tests share."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings

# The machine may be busy: no test is judged by its time, pytest-timeout ends what hangs.
settings.register_profile("robomend", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("robomend")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run soak, fuzz and kill loops at their full length")


@pytest.fixture(scope="session")
def long(request: pytest.FixtureRequest) -> bool:
    """Whether the long versions were asked for."""
    return bool(request.config.getoption("--long"))


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"
