"""What CONTRIBUTING.md and CI say is there."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_every_file_that_the_page_names_is_there() -> None:
    named = set(re.findall(r"`((?:[\w.]+/)+[\w.]*|[\w.-]+\.(?:py|yaml|toml|md))`", PAGE))
    assert {name for name in named if not (ROOT / name).exists()} == set()


PRODUCT = ("service", "clients", "board_emulator")
SOURCE = re.compile(r"(?<![\w./-])(?:[a-z_0-9]+/)*[a-z_0-9]+\.py\b(?!:)")
"""A source file as docs name it, with as much of its path as it takes. `horn.py:Horn` is a user's."""

OF_USERS = re.compile(r"my_|pulse\.py|battery\.py")
"""What the pages let their readers write."""


def test_every_source_file_that_a_page_or_a_module_names_is_there() -> None:
    pages = {
        page: re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
        for page in (ROOT / "docs").glob("*.md")
    }
    inline = {page: " ".join(re.findall(r"`[^`\n]+`", text)) for page, text in pages.items()}
    modules = [module for place in PRODUCT for module in (ROOT / place).rglob("*.py")]
    docs = {module: ast.get_docstring(ast.parse(module.read_text())) or "" for module in modules}
    there = {
        f"/{file.relative_to(ROOT)}"
        for place in (*PRODUCT, "tests", "docs", "examples")
        for file in (ROOT / place).rglob("*.py")
    }
    assert [
        f"{file.relative_to(ROOT)}: {name}"
        for file, text in {**inline, **docs}.items()
        for name in SOURCE.findall(text)
        if not OF_USERS.match(name) and not any(known.endswith(f"/{name}") for known in there)
    ] == []


@pytest.mark.parametrize(("job", "distribution"), [("check", "."), ("clients", "clients")])
def test_ci_tests_every_python_that_is_promised(job: str, distribution: str) -> None:
    project = tomllib.loads((ROOT / distribution / "pyproject.toml").read_text())["project"]
    promised = [line.rpartition(" ")[2] for line in project["classifiers"] if "Python :: 3." in line]
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())["jobs"]
    assert sorted(jobs[job]["strategy"]["matrix"]["python"]) == sorted(promised)
    assert project["requires-python"] == f">={promised[0]}"


SILENCED = re.compile(r"#\s*(?:noqa|type:\s*ignore)\b(?P<rest>.*)")


def unexplained(text: str) -> list[int]:
    """Return the lines that silence a check without a reason beside it."""
    found = []
    for number, line in enumerate(text.splitlines(), 1):
        silenced = SILENCED.search(line)
        if silenced and not re.search(r"#\s*\S", silenced["rest"]):
            found.append(number)
    return found


def test_every_check_that_is_silenced_has_its_reason_beside_it() -> None:
    places = ("service", "clients", "board_emulator", "tests", "docs", "examples")
    files = sorted(file for place in places for file in (ROOT / place).rglob("*.py"))
    assert len(files) > 1000
    assert [
        f"{file.relative_to(ROOT)}:{number}"
        for file in files
        if file != Path(__file__)
        for number in unexplained(file.read_text(encoding="utf-8"))
    ] == []
