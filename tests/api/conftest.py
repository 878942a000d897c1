"""A service to talk to: the real application on a real socket,
its repair loop replaced by a recording double.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, cast

import httpx
import pytest
from tests.api.repairs_double import RepairsDouble

from robomend.api.runtime import Runtime
from robomend.api.server import Server, make_server
from robomend.repairs.repairs import make_repairs
from robomend.resources import resource
from robomend.security import digest, new_key
from robomend.settings import Settings
from robomend.store import Store, Transaction, api_keys

CERTIFICATES = httpx.create_ssl_context()
"""Loaded once: it takes 20 ms for each client."""

TEDUSAR = resource("examples", "tedusar.yaml").read_text(encoding="utf-8")


class Service:
    """A running service, and a client of it."""

    def __init__(
        self, url: str, runtime: Runtime, repairs: RepairsDouble | None, loop: asyncio.AbstractEventLoop
    ) -> None:
        self.url = url
        self.runtime = runtime
        self.repairs = cast(RepairsDouble, repairs)
        self.loop = loop
        self.http = httpx.Client(base_url=url, timeout=120, verify=CERTIFICATES)

    def api(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Make a request below /api/v1."""
        return self.http.request(method, f"/api/v1{path}", **options)

    def connect(self) -> socket.socket:
        """Return a bare connection, which gives up after a minute."""
        return socket.create_connection(("127.0.0.1", int(self.url.rsplit(":", 1)[1])), timeout=60)

    def run(self, work: Any) -> Any:
        """Run a coroutine on the service's event loop."""
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(60)

    def with_robot(self, robot: str = "r1", **config: Any) -> None:
        """Store the example model and a robot that follows it."""
        self.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
        made = self.api("PUT", f"/robots/{robot}", json={"model": "tedusar", **config})
        assert made.status_code == 201, made.text

    def observe(self, *sentences: str, robot: str = "r1", **more: Any) -> httpx.Response:
        """Post one batch."""
        body = {"observations": list(sentences), **more}
        return self.api("POST", f"/robots/{robot}/observations", json=body)

    def diagnosis(self, robot: str = "r1", **query: Any) -> dict[str, Any]:
        """Return the current diagnosis."""
        found: dict[str, Any] = self.api("GET", f"/robots/{robot}/diagnosis", params=query).json()
        return found

    def key(self, role: str, robot: str | None = None) -> str:
        """Create a key behind the interface's back, as `robomend keys` does."""
        text = new_key()

        def add(tx: Transaction) -> None:
            api_keys.add(tx, name=f"{role}-{text[-8:]}", hash=digest(text), role=role, robot=robot, by="test")

        self.run(self.runtime.store.write(add))
        self.runtime.app.state.gate.ring.forget()
        return text


def sign_in(service: Service, key: str, **headers: str) -> httpx.Response:
    """Sign in as a browser does, without keeping the cookie."""
    with httpx.Client(base_url=service.url, timeout=120, verify=CERTIFICATES) as browser:
        return browser.post("/api/v1/session", json={"key": key}, headers={"Origin": service.url, **headers})


def bad_sets(diagnosis: dict[str, Any]) -> list[set[str]]:
    """Return the bad components of each diagnosis."""
    return [set(one["bad"]) for one in diagnosis["result"]["diagnoses"]]


@contextmanager
def running(settings: Settings, *, repairs: bool = False) -> Iterator[Service]:
    """Serve in a thread of its own until the block ends; `repairs`: with real ones, not their double."""
    ready = threading.Event()
    found: dict[str, Any] = {}

    def note(url: str) -> None:
        found["url"] = url
        ready.set()

    async def serve() -> None:
        def make(store: Store, *_: Any) -> Any:
            found["repairs"] = RepairsDouble(store)
            return found["repairs"]

        found["runtime"] = Runtime(settings, make_repairs if repairs else make)
        found["server"] = make_server(found["runtime"], note)
        found["loop"] = asyncio.get_running_loop()
        await found["server"].serve()

    thread = threading.Thread(target=asyncio.run, args=(serve(),))
    thread.start()
    try:
        assert ready.wait(60), "the service did not start"
        service = Service(found["url"], found["runtime"], found.get("repairs"), found["loop"])
        with service.http:
            yield service
    finally:
        server: Server = found["server"]
        found["loop"].call_soon_threadsafe(server.handle_exit, 15, None)
        thread.join(60)
        assert not thread.is_alive(), "the service did not end"


StartService = Callable[..., Service]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[StartService]:
    """Start services with settings of the test's own; all use one data folder unless told otherwise."""
    with ExitStack() as stack:

        def begin(**settings: Any) -> Service:
            values: dict[str, Any] = {"port": 0, "data": tmp_path, **settings}
            return stack.enter_context(running(Settings(**values)))

        yield begin


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service that the tests of a module share; each uses names of its own."""
    with running(Settings(port=0, data=tmp_path_factory.mktemp("data"))) as shared:
        yield shared
