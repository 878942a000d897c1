"""Options and fixtures that every room's tests share."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings

# The machine may be busy: no test is judged by its time, pytest-timeout ends what hangs.
settings.register_profile("robomend", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("quick", settings.get_profile("robomend"), max_examples=10)
settings.load_profile("robomend")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run soak, fuzz and kill loops at their full length")
    parser.addoption(
        "--quick", action="store_true", help="fewer examples of each property, and no slow tests"
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--quick"):
        settings.load_profile("quick")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--quick"):
        left_out = [item for item in items if item.get_closest_marker("slow")]
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=left_out)


@pytest.fixture(scope="session")
def long(request: pytest.FixtureRequest) -> bool:
    """Whether the long versions were asked for."""
    return bool(request.config.getoption("--long"))


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"
