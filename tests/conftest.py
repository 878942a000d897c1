"""Options and fixtures that every room's tests share."""

from __future__ import annotations

import gc
import importlib
import os
import signal
import sys
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, settings
from tests.forked import at_once, share, shared
from tests.order import dealt, load

# The machine may be busy: no test is judged by its time, pytest-timeout ends what hangs.
settings.register_profile("long", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("robomend", settings.get_profile("long"), max_examples=30)
settings.load_profile("robomend")

NOWHERE = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  # for as long as the tests run

THEIRS = (
    *("ROS_DOMAIN_ID", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "CYCLONEDDS_URI"),
    *("ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP", "ROS_NAMESPACE"),
)
"""Where the robot is of whoever runs the tests, by their environment: those of the tests are elsewhere."""

gc.disable()  # until all tests are collected, as `robomend serve` does while it loads


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run soak, fuzz and kill loops at their full length")
    parser.addoption("--release", type=Path, help="a folder with the files of ./dev release, to be tried")


def pytest_configure(config: pytest.Config) -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun in the background, as a script does
        signal.signal(signal.SIGINT, signal.default_int_handler)  # or whatever tests start ignores Ctrl-C
    for name in THEIRS:
        os.environ.pop(name, None)
    if hasattr(config, "workerinput"):
        shared(config.workerinput["template"])
    config.addinivalue_line("markers", "long: another of the same kind; only --long runs it")
    if config.getoption("--long"):
        settings.load_profile("long")


@pytest.hookimpl(optionalhook=True)  # of xdist
def pytest_configure_node(node: Any) -> None:
    """Tell a worker, before it starts, from what its programs are forked."""
    node.workerinput["template"] = share()


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    if (worker := getattr(session.config, "workerinput", None)) is not None:
        load(session.config.args, int(worker["workerid"].removeprefix("gw")), worker["workercount"])


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--long"):
        items[:] = [item for item in items if item.get_closest_marker("long") is None]
    if (workers := getattr(config, "workerinput", {}).get("workercount")) is not None:
        items[:] = dealt(items, workers)


def pytest_collection_finish() -> None:
    """Have the garbage collector leave alone what was loaded: thousands of tests and what they import."""
    gc.freeze()
    gc.set_threshold(20_000, 50, 100)
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let go of the browser before a test in which an event loop may run, and set up where services log."""
    log_where_the_service_s_go(item.config)
    loaded = sys.modules.get("tests.browser")
    if loaded is not None and "browser" not in getattr(item, "fixturenames", ()):
        loaded.HELD.close(item.path)


@pytest.fixture(scope="session")
def long(request: pytest.FixtureRequest) -> bool:
    """Whether the long versions were asked for."""
    return bool(request.config.getoption("--long"))


def log_where_the_service_s_go(config: pytest.Config) -> None:
    """Services in this process log to stderr, as `robomend serve` does: stdout is for results.

    Between tests nobody catches it, and it would stand among the dots of the run. It is so before the first
    fixture of a test: that of a module may start a service, after a test that set up another log.
    """
    if (structlog := sys.modules.get("structlog")) is not None:  # the client is tested without it
        shown = config.getoption("capture") == "no"

        def of_that_moment(*_: object) -> Any:
            caught = shown or sys.stderr is not sys.__stderr__
            return structlog.PrintLogger(sys.stderr if caught else NOWHERE)

        structlog.reset_defaults()
        structlog.configure(logger_factory=of_that_moment)


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="session", autouse=True)
def _certificates_are_read_once() -> Iterator[None]:
    """httpx reads what this computer trusts for each client and each httpx.get: 25 ms of the processor."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("httpx._transports.default.create_ssl_context", cache(httpx.create_ssl_context))
        yield


@pytest.fixture(scope="session", autouse=True)
def _workers_begin_at_once() -> Iterator[None]:
    """The workers of services in this process are forked from one that has loaded the planners."""
    with pytest.MonkeyPatch.context() as patch:
        if find_spec("robomend") is not None:  # the client is tested without it
            at_once(patch, importlib.import_module("robomend.workers.process"))
        yield
