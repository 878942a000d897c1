"""A real Chromium for tests: installed if it is missing and we may, started once a session, gone afterwards.

It is Chromium's headless shell, as Playwright would take; a whole Chromium where that is all there is.
Use it from a conftest.py: `from tests.browser import browser, chromium`. Where there is none and none can be
installed, tests that need it are skipped with the reason; in CI (`CI` in the environment) that is a failure.

Playwright's sync API leaves an event loop in the thread while it is open, in which no other can run: keep
tests that use `browser` in modules of their own. It stays open from module to module, as its start takes more
than a second of the processor, until a test of another module has no use for it (tests/conftest.py).
"""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, Request, expect, sync_playwright
from tests import network, packages
from tests.waiting import until

FLAGS = (
    "--headless",
    "--hide-scrollbars",  # as on a phone: a picture is as wide as its page
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--remote-debugging-port=0",
)

PICTURES = Path(__file__).resolve().parents[1] / "report" / "page"
"""Where screenshots go with --long, to be looked at by people; not in the repository."""

PATIENCE_MS = 60_000
"""A safety net: tests wait for what they need."""

expect.set_options(timeout=PATIENCE_MS)

_PR_SET_PDEATHSIG = 1


def _end_with_parent() -> None:
    """Make the kernel stop the browser when the test process is killed."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


@pytest.fixture(scope="session")
def chromium() -> Iterator[str]:
    """The session's browser, running: its debugging address."""
    why = "" if packages.chromium() else packages.CHROMIUM.install()
    program = packages.chromium()
    if program is None:
        reason = f"these tests need Chromium: {why}"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    folder = Path(tempfile.mkdtemp(prefix="robomend-chromium-"))
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={folder / 'profile'}", "about:blank"],
            stdout=log,
            stderr=log,
            preexec_fn=_end_with_parent,
            start_new_session=True,
        )
    port = folder / "profile" / "DevToolsActivePort"
    try:
        until(lambda: port.exists() and port.read_text().count("\n"), "Chromium listens", 60)
        yield f"http://127.0.0.1:{port.read_text().splitlines()[0]}"
    finally:
        HELD.close()
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(60)
        shutil.rmtree(folder, ignore_errors=True)


class Held:
    """The session's browser as Playwright knows it, while it is open."""

    def __init__(self) -> None:
        self.pictures = False
        """Whether screenshots are kept."""
        self._browser: Browser | None = None
        self._stack = ExitStack()
        self._user: Path | None = None

    def open(self, address: str, user: Path) -> Browser:
        """Return it for a test of the module `user`."""
        self._user = user
        if self._browser is None:
            playwright = self._stack.enter_context(sync_playwright())
            self._browser = playwright.chromium.connect_over_cdp(address, timeout=PATIENCE_MS)
            self._stack.callback(self._browser.close)
        return self._browser

    def close(self, but_for: Path | None = None) -> None:
        """Let it go, unless a test of the module `but_for` was the last to use it."""
        if self._browser is not None and self._user != but_for:
            self._browser = None
            self._stack.close()


HELD = Held()


@pytest.fixture
def browser(chromium: str, request: pytest.FixtureRequest) -> Iterator[Browser]:
    """The session's browser, as Playwright knows it, on a network that nobody changes meanwhile."""
    HELD.pictures = bool(request.config.getoption("--long"))
    with network.still():
        yield HELD.open(chromium, request.path)


class Watched:
    """A browser context that notes every request, and whatever a page complains of."""

    def __init__(self, context: BrowserContext, url: str) -> None:
        self.context = context
        self.url = url
        self.requests: list[str] = []
        self.complaints: list[str] = []
        context.set_default_timeout(PATIENCE_MS)
        context.on("request", self._asked)
        context.on("weberror", lambda error: self.complaints.append(str(error.error)))
        context.on("console", lambda said: self._said(said.type, said.text))

    def _asked(self, request: Request) -> None:
        self.requests.append(request.url)

    def _said(self, kind: str, text: str) -> None:
        if kind == "error" and "Failed to load resource" not in text and "ERR_" not in text:
            self.complaints.append(text)

    def page(self, path: str = "/") -> Page:
        """Open a page of the service."""
        opened = self.context.new_page()
        opened.goto(self.url + path)
        return opened

    def check(self) -> None:
        """No request left the service, no script failed, nothing was refused by the page's own policy."""
        ours = urlsplit(self.url).netloc
        schemes = {"data", "about", "blob"}
        foreign = [
            asked
            for asked in self.requests
            if urlsplit(asked).netloc != ours and urlsplit(asked).scheme not in schemes
        ]
        assert foreign == []
        assert self.complaints == []


def keep(page: Page, name: str) -> None:
    """Keep a screenshot of the whole page, with --long."""
    if not HELD.pictures:
        return
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.evaluate("scrollTo(0, 0)")  # what sticks to the top belongs there
    page.screenshot(path=PICTURES / f"{name}.png", full_page=True)
