"""Reports of benchmarks on the page: read as they are written, and shown as text and pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect
from tests.api.conftest import Service, running
from tests.browser import keep
from tests.web.conftest import Look
from tests.web.test_fleet import live, serious

from robomend.settings import Settings
from robomend.web.benchmark_reports import MOST_BYTES
from robomend_bench.charts import cactus
from robomend_bench.results import Run, Sample
from robomend_bench.tables import markdown

RUN = Run(
    suite="iscas85",
    mode="first",
    command="robomend-bench iscas85 --only c432",
    seed=1,
    contenders=("sat", "rc2"),
    machine={"cpu": "a|b", "cores": 2, "load": 0.1, "system": "Linux", "python": "3.11", "versions": {}},
    started="2026-01-01T00:00:00+00:00",
    samples=tuple(Sample("c432", 160, "one", who, 0, "ok", 0.01, (1,)) for who in ("sat", "rc2")),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of reports, with what does not belong there."""
    root = tmp_path_factory.mktemp("reports")
    made = root / "reports"
    made.mkdir()
    (made / "iscas85-first.md").write_text(markdown(RUN))
    (made / "iscas85-first-cactus.svg").write_text(cactus(RUN))
    (made / "bad.md").write_text(
        "## <script>alert(1)</script>\n\n| a |\n|---|\n| <img src=x onerror=alert(1)> |\n"
    )
    (root / "secret.md").write_text("secret")
    (made / "linked.md").symlink_to(root / "secret.md")
    (made / "large.md").write_text("x" * (MOST_BYTES + 1))
    return made


@pytest.fixture(scope="module")
def shown(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with running(Settings(port=0, data=tmp_path_factory.mktemp("data"), benchmark_folder=folder)) as service:
        yield service


def test_a_report_is_shown_with_its_plots(shown: Service, look: Look) -> None:
    page = live(look(shown, viewport={"width": 390, "height": 800}), "/ui/benchmarks")
    page.get_by_role("link", name="iscas85-first").click()
    expect(page.get_by_role("heading", name="iscas85 version 1, first")).to_be_visible()
    expect(page.locator("main p code")).to_have_text("robomend-bench iscas85 --only c432")
    expect(page.locator("table.report tbody tr")).to_have_count(2)
    plot = page.locator("img.plot")
    expect(plot).to_have_count(1)
    page.wait_for_function("document.querySelector('img.plot').naturalWidth > 100")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert serious(page) == []
    keep(page, "benchmark-390")
    page.goto(f"{shown.url}/ui/benchmarks/bad")
    assert "<img src=x onerror=alert(1)>" in page.locator("table.report").inner_text()
    assert page.locator("main img, main script").count() == 0


def test_what_is_not_there_is_said(shown: Service, service: Service) -> None:
    listed = re.findall(r'href="/ui/benchmarks/([^"]+)"', shown.http.get("/ui/benchmarks").text)
    assert {*listed} == {"iscas85-first", "bad", "large"}
    for outside in ("linked", "large", "none", "plots/bad.md", "plots/linked.md", "plots/..%2Fsecret.md"):
        assert shown.http.get(f"/ui/benchmarks/{outside}").status_code == 404, outside
    assert (
        shown.http.get("/ui/benchmarks/plots/iscas85-first-cactus.svg").headers["content-type"]
        == "image/svg+xml"
    )
    assert "does not know where reports are" in service.http.get("/ui/benchmarks").text
    assert service.http.get("/ui/benchmarks/iscas85-first").status_code == 404
