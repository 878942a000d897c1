"""Measurements: what is saved, summed up, compared and drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from robomend.errors import InputError
from robomend_bench.charts import cactus, scaling
from robomend_bench.results import (
    Built,
    Run,
    Sample,
    disagreements,
    duels,
    load,
    save,
    summarise,
)
from robomend_bench.tables import comparison, comparisons, markdown, times, too_dear

MACHINE = {"cpu": "c", "cores": 2, "load": 0.1, "system": "s", "python": "3", "versions": {"robomend": "0"}}


def sample(group: str, size: int, question: str, contender: str, took_s: float, **more: object) -> Sample:
    plain = Sample(group, size, question, contender, 0, "ok", took_s, (1, 1), 1)
    return replace(plain, **more)  # type: ignore[arg-type]  # fields of Sample, by name


RUN = Run(
    suite="toy",
    mode="all",
    command="robomend-bench toy",
    seed=1,
    contenders=("a", "b <&>"),
    machine=MACHINE,
    started="2026-01-01T00:00:00+00:00",
    samples=(
        sample("small", 10, "q1", "a", 0.002),
        sample("small", 10, "q1", "a", 0.001, repeat=1),
        sample("small", 10, "q1", "b <&>", 0.004),
        sample("small", 10, "q2", "a", 0.003),
        sample("small", 10, "q2", "b <&>", 0.030),
        sample("large", 100, "q1", "a", 0.02),
        sample("large", 100, "q1", "b <&>", 9.0, status="timeout", result=None),
    ),
    built=(Built("small", "a", 0.1, 30.0, 42.0),),
)


def test_a_run_is_saved_and_read_back(tmp_path: Path) -> None:
    save(RUN, tmp_path / "run.json")
    assert load(tmp_path / "run.json") == RUN


NO_RUNS = ["", "{}", "[]", '{"robomend_bench": 99}', '{"robomend_bench": 1, "samples": [1]}']


@pytest.mark.parametrize("text", NO_RUNS)
def test_what_is_no_run_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "other.json").write_text(text)
    with pytest.raises(InputError, match=r"other\.json"):
        load(tmp_path / "other.json")


def test_a_ratio_of_five_questions_has_an_interval() -> None:
    took = {"a": 0.001, "b <&>": 0.004}
    run = replace(
        RUN,
        samples=tuple(
            sample("small", 10, f"q{index}", name, seconds_ * (1 + index * (name != "a")))
            for index in range(5)
            for name, seconds_ in took.items()
        ),
    )
    first, second = summarise(run)
    assert first.ratio_between == (1.0, 1.0)
    assert second.ratio_between is not None
    low, high = second.ratio_between
    assert second.ratio == 12.0
    assert 4.0 <= low < 12.0 < high <= 20.0
    assert f"12.0× ({times(low)[:-1]}-{times(high)[:-1]}) |" in markdown(run)
    few = replace(run, samples=run.samples[:8])
    assert [line.ratio_between for line in summarise(few)] == [None, None]


DUEL = replace(
    RUN,
    contenders=("a", "slow", "fast"),
    samples=(
        *(sample("g", 1, f"q{i}", "a", 0.001) for i in range(9)),
        sample("g", 1, "q9", "a", 0.9),
        *(sample("g", 1, f"q{i}", "slow", 0.9) for i in range(10)),
        *(sample("g", 1, f"q{i}", "fast", 0.004) for i in range(10)),
        sample("other", 2, "q", "a", 0.001),
        sample("other", 2, "q", "slow", 0.003),
        sample("other", 2, "q", "fast", 0.5, status="timeout", result=None),
        sample("nobody", 3, "q", "a", 0.5, status="timeout", result=None),
    ),
)


def test_the_first_contender_is_held_against_the_fastest_other_of_each_group() -> None:
    first, second = duels(DUEL)
    assert (first.group, first.against, second.group, second.against) == ("g", "fast", "other", "slow")
    assert first.ratio == pytest.approx(4.0)
    assert first.most_ratio == pytest.approx(4.0)
    assert (first.lost, first.asked) == (1, 10)
    assert first.lost_by_s == pytest.approx(0.896)
    assert second.ratio == pytest.approx(3.0)
    assert (second.lost, second.lost_by_s) == (0, 0.0)
    text = markdown(DUEL)
    assert "| g | fast | 4.00× | 4.00× | 1/10 | 896 ms |" in text
    assert "means over groups: 3.46×" in text
    assert "faster than a on 1 of 11 questions" in text


def test_different_complete_answers_are_disagreements() -> None:
    assert disagreements(RUN.samples) == ()
    wrong = sample("small", 10, "q1", "c", 0.1, result=(2, 1))
    (text,) = disagreements([*RUN.samples, wrong])
    assert text == "small/q1: (1, 1) by a/b <&>, (2, 1) by c"
    assert disagreements([*RUN.samples, replace(wrong, status="timeout")]) == ()


def test_two_runs_are_compared_over_what_both_solved() -> None:
    faster = replace(RUN, samples=tuple(replace(s, seconds=s.seconds / 2) for s in RUN.samples[:5]))
    text = comparison(RUN, faster)
    assert "| small | a | 2 | 2.00 ms | 1.00 ms | 0.50× | 0 | 0 |" in text
    assert "| large | a | 0 | - | - | - | 1 | 0 |" in text
    other = replace(RUN, samples=(replace(RUN.samples[0], result=(5, 1)),))
    assert "The answers differ" in comparison(RUN, other)


@pytest.mark.parametrize("draw", [cactus, scaling])
def test_plots_are_well_formed_and_name_each_contender(draw: object) -> None:
    assert callable(draw)
    tree = ElementTree.fromstring(draw(RUN))
    texts = {element.text for element in tree.iter("{http://www.w3.org/2000/svg}text")}
    assert {"a", "b <&>"} <= texts
    width, height = float(tree.attrib["width"]), float(tree.attrib["height"])
    for line in tree.iter("{http://www.w3.org/2000/svg}line"):
        assert all(0 <= float(line.attrib[key]) <= width for key in ("x1", "x2"))
        assert all(0 <= float(line.attrib[key]) <= height for key in ("y1", "y2"))


# --- costs of plans: equal, dearer within what is promised, and too dear

EXACT = Sample("g", 9, "q1", "exact", 0, "ok", 0.1, (), 3, cost=20.0, bound=1.0)
NEAR = replace(EXACT, contender="near", bound=1.1)


def test_equal_costs_are_fine() -> None:
    assert too_dear([EXACT, NEAR]) == ()


def test_a_contender_may_be_as_much_dearer_as_it_promises_and_no_more() -> None:
    assert too_dear([EXACT, replace(NEAR, cost=22.0)]) == ()
    (text,) = too_dear([EXACT, replace(NEAR, cost=23.0)])
    assert text.startswith("g/q1: 23 by near, 1.15× the cheapest known (20)")


def test_the_report_says_on_how_many_questions_costs_are_equal() -> None:
    other = [replace(EXACT, question="q2"), replace(NEAR, question="q2", cost=21.0)]
    unsolved = replace(EXACT, question="q3")
    samples = (EXACT, NEAR, *other, unsolved)
    run = Run("toy", "cost", "", 1, ("exact", "near", "absent"), {}, "", samples=samples)
    (text,) = comparisons(run)
    assert text.startswith("g: cost of exact and near equal on 1 of the 2 both solved")
    assert text.endswith("else 0.95× to 1.00× (together 40 and 41).")
