"""No test sleeps where it could wait: a sleep that no event can replace has its reason beside it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tests import waiting

TESTS = Path(__file__).parent

LOOK_S = 0.2
"""A loop that looks may sleep for so long between two looks."""


def sleeps(tree: ast.Module) -> Iterator[tuple[ast.Call, bool]]:
    """Yield the calls of `sleep`, and whether each is in a `while` of its function: in a loop that looks."""

    def walk(node: ast.AST, looks: bool) -> Iterator[tuple[ast.Call, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Call) and ast.unparse(child.func).rpartition(".")[2] == "sleep":
                yield child, looks
            inside = isinstance(child, ast.While) or (looks and not isinstance(child, FUNCTIONS))
            yield from walk(child, inside)

    yield from walk(tree, False)


FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


def allowed(call: ast.Call, looks: bool, line: str) -> bool:
    """Whether it gives way, looks again and again, or says why it sleeps."""
    duration = call.args[0] if call.args else None
    if isinstance(duration, ast.Constant) and isinstance(duration.value, int | float):
        if duration.value == 0 or (looks and duration.value <= LOOK_S):
            return True
    elif looks and isinstance(duration, ast.Name) and duration.id == "LOOK_S":
        return True
    return "#" in line


def test_every_sleep_looks_or_has_its_reason_beside_it() -> None:
    found = []
    for file in sorted(TESTS.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        lines = text.splitlines()
        for call, looks in sleeps(ast.parse(text)):
            if not allowed(call, looks, lines[call.lineno - 1]):
                found.append(f"{file.relative_to(TESTS)}:{call.lineno}: {lines[call.lineno - 1].strip()}")
    assert not found, "wait for the event (tests/waiting.py), or say why there is none:\n" + "\n".join(found)


def test_a_sleep_without_a_reason_is_found() -> None:
    text = "def test():\n    time.sleep(1)\n    while wrong():\n        sleep(0.1)\n    sleep(2)  # because\n"
    lines = text.splitlines()
    refused = [
        call.lineno
        for call, looks in sleeps(ast.parse(text))
        if not allowed(call, looks, lines[call.lineno - 1])
    ]
    assert refused == [2]


def test_who_looks_does_so_a_quarter_of_the_time_at_most_and_soon_again() -> None:
    assert waiting.look_s(0.0) == waiting.LOOK_S
    assert waiting.look_s(100.0) == waiting.SELDOM_S
    assert waiting.look_s(100.0, took_s=0.04) == 3 * 0.04
    assert waiting.look_s(0.0, took_s=100.0) == waiting.MOST_S
