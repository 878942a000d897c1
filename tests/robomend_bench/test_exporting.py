"""Exported questions: other solvers, by other ways, come to the answers that are told with them."""

from __future__ import annotations

import hashlib
import json
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import clingo
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pysat.examples.rc2 import RC2
from pysat.formula import WCNF
from tests.diagnosis.systems import model, satisfiable, systems

from robomend.model.cnf import HealthCnf
from robomend_bench.exporting import DiagnosisProblem
from robomend_bench.main import main
from robomend_client.literals import Atom, Literal


def by_rc2(text: str) -> int | None:
    with RC2(WCNF(from_string=text)) as search:
        return search.cost if search.compute() is not None else None


def by_clingo(text: str) -> int | None:
    control: Any = clingo.Control(["--opt-mode=opt"], logger=lambda code, message: None)
    control.add("base", [], text)
    control.ground([("base", [])])
    sizes: list[int] = []
    control.solve(on_model=lambda model: sizes.append(len(model.symbols(shown=True))))
    return sizes[-1] if sizes else None


def least(cnf: HealthCnf, snapshots: list[frozenset[Literal]]) -> int | None:
    """Return the size of a smallest set that explains each snapshot, by the definition.

    Who is in the set may be healthy or not, in each snapshot anew: only the others are assumed to be well.
    """
    n = len(cnf.components)
    for size in range(n + 1):
        for bad in combinations(range(1, n + 1), size):
            healthy = [(variable,) for variable in range(1, n + 1) if variable not in bad]
            seen = [[(cnf.literal(literal) or 0,) for literal in snapshot] for snapshot in snapshots]
            if all(satisfiable([*cnf.clauses, *healthy, *one], cnf.variables) for one in seen):
                return size
    return None


SEEN_TO_BE_WELL = (
    model(2, [(-1, -3), (1, 3), (-1, -2)], atoms=1),
    frozenset({Literal(Atom("ok", ("a1",)), False)}),
)
"""c1 is well exactly where a1 is not seen: over both, it must be blamed and now and then be well."""


@settings(max_examples=40, deadline=None)
@example(SEEN_TO_BE_WELL, [{0: True}])
@given(systems(), st.lists(st.dictionaries(st.integers(0, 3), st.booleans()), max_size=1))
def test_both_formats_have_the_minimum_cardinality_for_an_optimum(
    system: tuple[HealthCnf, frozenset[Literal]], more: list[dict[int, bool]]
) -> None:
    cnf, seen = system
    snapshots = [seen, *(frozenset(Literal(cnf.atoms[i], sign) for i, sign in one.items()) for one in more)]
    asked = DiagnosisProblem(cnf, snapshots)
    expected = least(cnf, snapshots)
    assert by_rc2(asked.wcnf()) == expected
    assert by_clingo(asked.lp()) == expected
    answer = asked.answer()
    assert answer is not None
    assert answer.get("minimum_cardinality") == expected
    assert ("solvable" in answer) == (expected is None)


def exported(monkeypatch: pytest.MonkeyPatch, folder: Path, *arguments: str) -> dict[str, Any]:
    monkeypatch.setattr(sys, "argv", ["robomend-bench", "export", *arguments, "--out", str(folder)])
    main()
    told: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
    return told


@pytest.mark.parametrize(
    "suite",
    ["iscas85 --only c17,c432 --instances 2", "robots-v1 --only 20 --instances 3", "odd --only chain-50"],
)
def test_what_is_told_is_what_other_solvers_find_in_the_files(
    suite: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for format_, solve in (("wcnf", by_rc2), ("lp", by_clingo)):
        folder = tmp_path / format_
        told = exported(monkeypatch, folder, *suite.split(), "--format", format_)
        assert told["files"]
        for file in told["files"]:
            data = (folder / file["file"]).read_bytes()
            assert hashlib.sha256(data).hexdigest() == file["sha256"]
            assert (
                solve(data.decode())
                == file["answer"]["minimum_cardinality"]
                == len(file["answer"]["diagnosis"])
            )


def test_repair_problems_are_pddl_with_the_least_cost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = exported(
        monkeypatch, tmp_path, *["plans", "--mode", "cost", "--only", "small-robots", "--instances", "1"]
    )
    assert "(domain robot-repair)" in (tmp_path / "domain.pddl").read_text()
    for file in told["files"]:
        assert "(:goal" in (tmp_path / file["file"]).read_text()
        assert file["answer"]["cost"] > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("iscas85", "--only", "c17", "--format", "pddl"), "no questions that can be said in pddl"),
        (("plans", "--only", "tedusar", "--format", "lp"), "no questions that can be said in lp"),
        (("robots-v1", "--mode", "rows", "--only", "20", "--instances", "1"), "rows are no question"),
        (("iscas85", "--mode", "best"), "has no mode 'best'"),
        (("nothing",), "no suite is named 'nothing'"),
    ],
)
def test_what_cannot_be_exported_is_refused(
    arguments: tuple[str, ...],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit, match="2"):
        exported(monkeypatch, tmp_path, *arguments)
    assert message in capsys.readouterr().err


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(SystemExit):
        exported(monkeypatch, tmp_path, "iscas85", "--only", "c17")
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
