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
PLACES = re.findall(r"^\| (.+?) \| `(.+?)` \| `(.+?)` \|$", PAGE, re.MULTILINE)


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


@pytest.mark.parametrize(("thing", "begin", "docs"), PLACES, ids=[thing for thing, _, _ in PLACES])
def test_the_module_where_something_begins_says_how_it_goes_on(thing: str, begin: str, docs: str) -> None:
    docstring = (ROOT / begin).read_text(encoding="utf-8").split('"""')[1]
    assert re.search(r"\b(To add|To keep|Adding) (an?|another|one)\b", docstring), f"{begin} says nothing"
    assert (ROOT / docs).exists()


def test_every_command_of_dev_is_on_the_page() -> None:
    commands = set(re.findall(r"^#   (\./dev \w+)", (ROOT / "dev").read_text(), re.MULTILINE))
    assert {command for command in commands if command not in PAGE} == set()


def test_ci_runs_what_a_developer_runs_on_every_python_that_is_promised() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    promised = {line.rpartition(" ")[2] for line in project["classifiers"] if "Python :: 3." in line}
    job = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())["jobs"]["check"]
    assert set(job["strategy"]["matrix"]["python"]) == promised
    assert [step["run"] for step in job["steps"] if "run" in step][-1] == ".ci/run"
    assert "./dev check" in (ROOT / ".ci" / "run").read_text()


def test_the_client_is_tested_on_every_python_that_it_promises() -> None:
    project = tomllib.loads((ROOT / "clients" / "pyproject.toml").read_text())["project"]
    promised = [line.rpartition(" ")[2] for line in project["classifiers"] if "Python :: 3." in line]
    job = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())["jobs"]["clients"]
    assert job["strategy"]["matrix"]["python"] == promised
    assert job["steps"][-1]["run"] == "./dev test --client ${{ matrix.python }}"
    assert f"set -- {' '.join(promised)}\n" in (ROOT / "dev").read_text()
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
