"""The pages name every route, error code and setting."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

from robomend import errors
from robomend.api.problems import HTTP_CODES
from robomend.security import API, RULES
from robomend.settings import Settings

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def page() -> str:
    return (DOCS / "http.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("rule", RULES, ids=" ".join)
def test_every_route_is_on_the_page(page: str, rule: tuple[str, str]) -> None:
    method, path = rule
    short = f"`{path.removeprefix(API) or path}`"
    lines = [line for line in page.splitlines() if line.startswith("| ") and short in line]
    assert any(method in line.split("`")[0] for line in lines), f"no row for {method} {short}"


def test_every_error_code_is_on_the_page(page: str) -> None:
    kinds = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]
    codes = {kind.code for kind in kinds if issubclass(kind, errors.RobomendError)}
    common = {HTTP_CODES[status] for status in (400, 401, 404, 405, 408, 413, 415, 422, 429, 500, 503)}
    missing = {code for code in codes | common if f"`{code}`" not in page}
    assert missing == set()


def test_every_setting_is_on_its_page() -> None:
    page = (DOCS / "settings.md").read_text(encoding="utf-8")
    assert {name for name in Settings.model_fields if f"| `{name}` |" not in page} == set()
