"""The site: built strictly, without the internet then and later, and with all that the code has."""

from __future__ import annotations

import os
import re
import runpy
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
HOOKS = ROOT / "docs" / "mkdocs_hooks.py"

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


def test_a_link_to_a_file_that_is_not_there_ends_the_build() -> None:
    hooks = runpy.run_path(str(HOOKS))
    link = hooks["LINK"].search("see [it](../service/robomend/nowhere.py)")
    with pytest.raises(Exception, match=r"docs/agent.md: there is no service/robomend/nowhere.py"):
        hooks["turned"](link, "docs/agent.md", "agent.md")


@pytest.mark.parametrize(
    ("text", "source", "uri", "turned"),
    [
        ("[a](docs/agent.md#actions)", "README.md", "index.md", "[a](agent.md#actions)"),
        ("[deploy](deploy/README.md)", "docs/tutorial.md", "tutorial.md", "[deploy](deploy/README.md)"),
        ("[h](../http.md)", "docs/deploy/README.md", "deploy/README.md", "[h](../http.md)"),
        ("[`x`](../service/robomend/cycle.py)", "docs/design.md", "design.md", "`x`"),
        ("[e](../examples/agent.yaml)", "docs/agent.md", "agent.md", "[e](examples/agent.yaml)"),
        ("[s](../SECURITY.md)", "docs/security.md", "security.md", "[s](reporting.md)"),
        ("[r](reference.py#http)", "docs/sovd.md", "sovd.md", "[r](reference/http.md)"),
        ("[w](https://example.org/x)", "README.md", "index.md", "[w](https://example.org/x)"),
    ],
)
def test_a_link_of_the_repository_becomes_one_of_the_site(
    text: str, source: str, uri: str, turned: str
) -> None:
    hooks = runpy.run_path(str(HOOKS))
    assert hooks["LINK"].sub(lambda link: hooks["turned"](link, source, uri), text) == turned


def test_a_state_machine_is_a_table_of_its_arrows() -> None:
    drawn = (
        'stateDiagram-v2\n    [*] --> idle\n    state "under-way" as under_way\n    idle --> under_way : go\n'
    )
    assert runpy.run_path(str(HOOKS))["machine"](drawn).splitlines()[2:] == [
        "| (begin) | idle |  |",
        "| idle | under-way | go |",
    ]
