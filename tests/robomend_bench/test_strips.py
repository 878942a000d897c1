"""Repair problems as plain STRIPS: what another planner makes of them is right in the domain as written."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from pyperplan.planner import HEURISTICS, SEARCHES, search_plan

from robomend.planning.domain.loading import load_domain
from robomend.planning.plan import Outcome
from robomend.planning.planning import PlanOptions, plan_problem
from robomend.planning.problem import RepairProblem, repair_problem
from robomend.planning.validation import validate
from robomend_bench.exporting import Strips, strips
from robomend_bench.main import main
from robomend_bench.suites.plans import broken, random_robot, some_bad

OWN = """
(define (domain robot-repair)
  (:predicates (spare ?h - hardware))
  (:action swap
    :parameters (?h - hardware)
    :precondition (and (spare ?h) (or (not (good ?h)) (off ?h))
      (forall (?n - node) (imply (drives ?n ?h) (not (running ?n)))))
    :effect (and (good ?h) (not (bad ?h)) (increase (total-cost) 2)))
  (:init (spare device0)))
"""
"""A user's action whose precondition is disjunctive and negative."""


def problem_of(seed: int, text: str | None = None) -> tuple[RepairProblem, Strips, PlanOptions]:
    robot = random_robot(seed, 7, awkward=False)
    bad = some_bad(robot, 3, seed)
    domain = load_domain(text) if text else load_domain()
    problem = repair_problem(robot, domain, broken(robot, bad, seed), bad)
    return problem, strips(domain, problem, costs=False), PlanOptions(planner="asp", timeout_s=300.0)


def by_pyperplan(made: Strips, folder: Path) -> list[str] | None:
    """Return the shortest plan, as words."""
    (folder / "domain").write_text(made.domain)
    (folder / "problem").write_text(made.problem)
    found = search_plan(
        str(folder / "domain"), str(folder / "problem"), SEARCHES["astar"], HEURISTICS["hmax"]
    )
    return None if found is None else [operator.name.strip("() ") for operator in found]


@pytest.mark.parametrize("text", [None, OWN])
@pytest.mark.parametrize("seed", range(6))
def test_a_plan_of_another_planner_is_one_in_the_domain_as_written(
    seed: int, text: str | None, tmp_path: Path
) -> None:
    problem, made, options = problem_of(seed, text)
    domain = load_domain(text) if text else load_domain()
    found = by_pyperplan(made, tmp_path)
    assert found is not None
    plan = [made.actions[word] for word in found]
    assert validate(domain, problem, plan, problem.goal) is None
    ours = plan_problem(domain, problem, options)
    assert ours.outcome is Outcome.SOLVED
    assert len(plan) <= len(ours.steps)  # it is the shortest; ours is the cheapest


def test_strips_is_exported_with_a_domain_for_each_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = "robomend-bench export plans --mode cost --only small-robots --instances 1 --no-answers"
    for kind in ("strips", "strips-costs"):
        folder = tmp_path / kind
        monkeypatch.setattr("sys.argv", [*line.split(), "--format", kind, "--out", str(folder)])
        main()
        for file in json.loads((folder / "manifest.json").read_text())["files"]:
            domain = (folder / file["domain"]).read_text()
            assert "(:domain strips)" in (folder / file["file"]).read_text()
            assert ("total-cost" in domain) == (kind == "strips-costs")
            assert not re.search(r"forall|when|imply|\?", domain)
