"""The site: built strictly, without the internet then and later, and with all that the code has."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from tests.once import made_once

from robomend import errors
from robomend.api.problems import HTTP_CODES
from robomend.cli.commands import COMMANDS
from robomend.security import API, RULES
from robomend.settings import Settings
from robomend_client.events import Kind
from robomend_client.observers.kinds import KINDS

ROOT = Path(__file__).resolve().parents[1]

FETCHED = {("script", "src"), ("link", "href"), ("img", "src"), ("iframe", "src")}
NOT_FETCHED = {"canonical", "next", "prev"}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build it; whoever tries to reach another computer meanwhile finds a door that is shut."""

    def build(folder: Path) -> None:
        shut = "http://127.0.0.1:9"
        environment = {**os.environ, "http_proxy": shut, "https_proxy": shut, "NO_MKDOCS_2_WARNING": "1"}
        command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr

    return made_once(tmp_path_factory, "site", build)


class Looked(HTMLParser):
    """What a page fetches, and where its links lead."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.links: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given: dict[str, Any] = dict(attributes)
        for name, value in given.items():
            if (tag, name) in FETCHED and given.get("rel") not in NOT_FETCHED:
                self.fetched.append(value or "")
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])


def test_no_page_fetches_anything_from_elsewhere(site: Path) -> None:
    fetched = {url for page in site.rglob("*.html") for url in Looked(page).fetched}
    assert fetched
    assert {url for url in fetched if urlsplit(url).netloc} == set()


def test_every_link_leads_somewhere(site: Path) -> None:
    lost = set()
    for page in site.rglob("*.html"):
        if page.name == "404.html":
            continue  # it is shown anywhere, and its links begin at the root
        for link in Looked(page).links:
            parts = urlsplit(link)
            if not parts.scheme and parts.path and not (page.parent / unquote(parts.path)).exists():
                lost.add((page.name, link))
    assert lost == set()


def test_every_page_of_the_repository_is_on_the_site(site: Path) -> None:
    pages = {path.with_suffix(".html").name for path in (ROOT / "docs").glob("*.md")}
    assert {name for name in pages if not (site / name).exists()} == set()


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("commands", [f"robomend {name}" for name in COMMANDS]),
        ("settings", [f"ROBOMEND_{name.upper()}" for name in Settings.model_fields]),
        (
            "errors",
            [one.code for one in vars(errors).values() if hasattr(one, "code")] + list(HTTP_CODES.values()),
        ),
        ("events", [kind.value for kind in Kind]),
        ("observers", list(KINDS.names())),
        ("files", ["protected_channels", "twist.twist.angular.z", "stop_grace_s", "attempts_per_hour"]),
        ("http", [path for _, path in RULES if path.startswith(API)]),
    ],
)
def test_the_reference_has_what_the_code_has(site: Path, page: str, names: list[str]) -> None:
    text = re.sub(r"<[^>]+>", "", (site / "reference" / f"{page}.html").read_text(encoding="utf-8"))
    assert {name for name in names if name not in text} == set()
