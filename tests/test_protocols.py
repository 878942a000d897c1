"""A Protocol is for what has several implementations; one alone is a class that others import."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("service", "clients", "board_emulator")

SECOND_IN_TESTS = {
    "Repair": "tests/test_cycle.py",  # the loop is tested over a repair that does as it is told
    "FreshObs": "tests/repairs/lidar_robot.py",  # executions are tested on simulated robots
    "Seen": "tests/robots/test_start_ups.py",  # so are start-ups
    "Reader": "tests/clients/bridges/ros1/test_bursts.py",  # bursts are read from plain sockets
    "Switch": "tests/repairs/executors/test_board.py",  # a board that fails as it is told
}
"""What has its second implementation in a test."""


def classes(file: Path) -> Iterator[tuple[ast.ClassDef, frozenset[str]]]:
    """Yield the classes of a file, each with the names that it defines itself."""
    text = file.read_text(encoding="utf-8")
    for node in ast.parse(text).body if "class " in text else ():
        if isinstance(node, ast.ClassDef):
            yield node, frozenset(defined(node))


def defined(made: ast.ClassDef) -> Iterator[str]:
    """Yield methods, fields, and what `__init__` sets."""
    for one in made.body:
        if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef):
            yield one.name
        elif isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name):
            yield one.target.id
        elif isinstance(one, ast.Assign):
            yield from (target.id for target in one.targets if isinstance(target, ast.Name))
        if isinstance(one, ast.FunctionDef) and one.name == "__init__":
            for inner in ast.walk(one):
                if isinstance(inner, ast.Attribute) and isinstance(inner.ctx, ast.Store):
                    yield inner.attr


def bases(made: ast.ClassDef) -> set[str]:
    return {ast.unparse(base).partition("[")[0].rpartition(".")[2] for base in made.bases}


def is_protocol(made: ast.ClassDef) -> bool:
    """Whether it is typing's; asyncio's is a base class."""
    return any(isinstance(base, ast.Name) and base.id == "Protocol" for base in made.bases)


def with_inherited(found: list[tuple[ast.ClassDef, frozenset[str]]]) -> dict[str, frozenset[str]]:
    """Return class name -> its names, its bases' included; classes that share a name count as one."""
    own: dict[str, frozenset[str]] = {}
    above: dict[str, set[str]] = {}
    for made, names in found:
        own[made.name] = own.get(made.name, frozenset()) | names
        above.setdefault(made.name, set()).update(bases(made) - {made.name})

    @cache
    def whole(name: str) -> frozenset[str]:
        return own.get(name, frozenset()).union(*map(whole, above.get(name, ())))

    return {name: whole(name) for name in own}


def test_every_protocol_has_two_implementations() -> None:
    ours = [one for place in SOURCES for file in (ROOT / place).rglob("*.py") for one in classes(file)]
    protocols = {made.name: names for made, names in ours if is_protocol(made)}
    assert len(protocols) > 20
    concrete = with_inherited([(made, names) for made, names in ours if not is_protocol(made)]).values()
    alone = {name for name, wanted in protocols.items() if sum(wanted <= names for names in concrete) < 2}
    assert alone == SECOND_IN_TESTS.keys()
    for name, file in SECOND_IN_TESTS.items():
        doubles = with_inherited(list(classes(ROOT / file))).values()
        assert any(protocols[name] <= names for names in doubles), f"{file} has none of {name}"
