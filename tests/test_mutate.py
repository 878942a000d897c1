"""The mutation tester: what it changes, and that it tells a test that bites from one that does not."""

from __future__ import annotations

import ast
import subprocess
from pathlib import Path

import pytest
from tests.mutants import mutants
from tests.mutate import ROOMS, ROOT, Copy, equivalent, of_room, ordered, written_since

SOURCE = '''"""A docstring is no code."""

LIMIT: tuple[int, 5] = 7


def within(value, most=LIMIT):
    if value < 0 and not value == -3:
        raise ValueError(f"{value + 1} is below 0")
    return [one for one in range(value) if one in (most,)]
'''


def mutated(source: str) -> list[str]:
    text = source.encode()
    return [
        (text[: one.start] + one.becomes.encode() + text[one.end :]).decode() for one in mutants(source, "f")
    ]


def test_one_place_is_changed_at_a_time_and_what_is_said_stays() -> None:
    changed = [f"{one.was} -> {one.becomes}" for one in mutants(SOURCE, "f")]
    assert "value < 0 -> (value <= 0)" in changed
    assert "value < 0 and not value == -3 -> (value < 0 or not value == -3)" in changed
    assert "not value == -3 -> (value == -3)" in changed
    assert "one in (most,) -> (one not in (most,))" in changed
    assert "7 -> (8)" in changed
    assert not any("5" in one or "value + 1" in one or "docstring" in one for one in changed)
    for text in mutated(SOURCE):
        assert ast.dump(ast.parse(text)) != ast.dump(ast.parse(SOURCE))


@pytest.mark.parametrize("room", ROOMS)
def test_every_mutant_of_a_room_is_python(room: str) -> None:
    found = of_room(room)
    assert len(found) > 100
    for one in found[:: max(1, len(found) // 100)]:
        text = (ROOT / one.file).read_bytes()
        ast.parse(text[: one.start] + one.becomes.encode() + text[one.end :])


def test_what_is_named_as_equivalent_is_still_a_mutant() -> None:
    there = {one.key for room in ROOMS for one in of_room(room)}
    assert equivalent().keys() <= there
    assert all(len(reason) > 20 for reason in equivalent().values())


def test_what_was_written_since_a_revision_is_told_by_its_lines(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b", *words], cwd=tmp_path, check=True)

    file = tmp_path / "one.py"
    file.write_text("".join(f"line_{number} = {number}\n" for number in range(1, 10)))
    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "one")
    file.write_text(
        file.read_text().replace("line_3 = 3\n", "line_3 = 4\nmore = 5\n").replace("line_7 = 7\n", "")
    )
    (tmp_path / "new.py").write_text("new = 1\n")
    git("add", "new.py")
    assert written_since("HEAD", tmp_path) == {"one.py": {3, 4}, "new.py": {1}}


def test_the_test_that_mirrors_the_module_comes_first() -> None:
    first, *_ = ordered("service/robomend/planning/choice.py", ["tests/planning"])
    assert first == "tests/planning/test_choice.py"


def test_a_mutant_that_a_test_notices_is_killed_and_another_survives(tmp_path: Path) -> None:
    tree = Copy(tmp_path, copied=(), stages=[[]])
    (tmp_path / "judged.py").write_text("def larger(a, b):\n    return a if a > b else b\n")
    (tmp_path / "test_judged.py").write_text(
        "from judged import larger\n\n\ndef test_it():\n    assert larger(1, 2) == 2\n"
    )
    found = {
        one.becomes: tree.survives(one, ["test_judged.py"], 60)
        for one in mutants((tmp_path / "judged.py").read_text(), "judged.py")
    }
    assert found == {"(b if a > b else a)": False, "(a >= b)": True}
    assert "a > b" in (tmp_path / "judged.py").read_text()
    (tmp_path / "judged.py").write_text("while True:\n    pass\n")
    assert not tree.passes(["test_judged.py"], 2)
