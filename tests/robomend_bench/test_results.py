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
    percentile,
    ratio_at_least,
    save,
    slope,
    summarise,
)
from robomend_bench.tables import comparison, markdown, seconds, times

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


def test_lines_take_the_fastest_repeat_and_the_median_over_questions() -> None:
    first, second, large, late = summarise(RUN)
    assert (first.solved, first.asked, first.median_s, first.worst_s) == (2, 2, 0.002, 0.003)
    assert first.peak_mib == 42.0
    assert second.ratio == pytest.approx((4 + 10) / 2)
    assert (large.group, large.median_s) == ("large", 0.02)
    assert (late.solved, late.median_s, late.ratio) == (0, None, None)


def test_what_was_not_solved_counts_twice_the_time_out_in_par2() -> None:
    first, _, _, late = summarise(replace(RUN, timeout_s=7.0))
    assert first.par2_s == pytest.approx((0.001 + 0.003) / 2)
    assert late.par2_s == 14.0
    assert "| 14.0 s |" in markdown(replace(RUN, timeout_s=7.0))


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


def test_a_percentile_is_one_of_the_values() -> None:
    assert percentile([5, 1, 4, 2, 3, 9, 8, 7, 6, 10], 0.9) == 9
    assert percentile([2.0, 1.0], 0.5) == 1.0
    assert percentile([3.0], 0.9) == 3.0
    assert percentile([], 0.9) is None


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


def test_what_only_another_contender_solved_is_lost() -> None:
    late = replace(
        DUEL,
        samples=(
            sample("g", 1, "q", "a", 1.0, status="timeout", result=None),
            sample("g", 1, "q", "slow", 0.9),
        ),
    )
    (duel,) = duels(late)
    assert (duel.lost, duel.asked, duel.ratio) == (1, 1, 0.0)


def test_the_exponent_of_growth_is_the_slope() -> None:
    assert slope(RUN, "a") == pytest.approx(1.0)
    assert slope(RUN, "b <&>") is None


def test_different_complete_answers_are_disagreements() -> None:
    assert disagreements(RUN.samples) == ()
    wrong = sample("small", 10, "q1", "c", 0.1, result=(2, 1))
    (text,) = disagreements([*RUN.samples, wrong])
    assert text == "small/q1: (1, 1) by a/b <&>, (2, 1) by c"
    assert disagreements([*RUN.samples, replace(wrong, status="timeout")]) == ()


def test_times_have_three_digits_and_a_unit() -> None:
    assert [seconds(t) for t in (4.7e-6, 1.234e-4, 0.039, 1.2, 75.0, None)] == [
        "4.70 µs",
        "123 µs",
        "39.0 ms",
        "1.20 s",
        "75.0 s",
        "-",
    ]
    assert [times(r) for r in (0.5, 12.34, 1234.0, None)] == ["0.50×", "12.3×", "1234×", "-"]


def test_the_report_says_what_was_run_and_where() -> None:
    text = markdown(RUN)
    assert "| small | 10 | a | 2/2 | 2.00 ms | 3.00 ms | 3.00 ms | 2.00 ms | 1.00× | 1 | 42 MiB |" in text
    assert "| large | 100 | b <&> | 0/1 | - | - | - | 20.0 s | - |" in text
    assert "All contenders gave the same answers." in text
    assert "`robomend-bench toy`" in text
    assert "2026-01-01" in text
    assert "**1 disagreements**" in markdown(replace(RUN, disagreements=("small/q1: …",)))


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


def test_a_run_in_which_nothing_was_solved_is_still_drawn() -> None:
    nothing = replace(RUN, samples=tuple(replace(s, status="timeout") for s in RUN.samples))
    assert "none solved" in cactus(nothing)
    assert "none solved" in scaling(nothing)


def test_questions_that_were_not_finished_bound_the_ratio_from_below() -> None:
    small = (
        sample("small", 10, "q3", "a", 0.001),
        sample("small", 10, "q3", "b <&>", 0.5, status="timeout", result=None),
        sample("small", 10, "q4", "b <&>", 9.0, status="timeout", result=None),  # "a" has no answer either
    )
    run = replace(RUN, samples=(*RUN.samples, *small))
    assert ratio_at_least(run, "b <&>", "small") == (1, 10.0)  # of 4×, 10× and 500× or more
    assert ratio_at_least(run, "a", "small") is None
    assert "b <&> on small: the ratio is at least 10.0× when what it did not finish (1) counts" in markdown(
        run
    )


def test_the_wall_time_of_a_killed_contender_bounds_no_cpu_time() -> None:
    killed = replace(RUN.samples[-1], note="killed")
    run = replace(RUN, samples=(*RUN.samples[:-1], killed))
    assert ratio_at_least(run, "b <&>", "large") == (1, 450.0)
    assert ratio_at_least(replace(run, clock="cpu"), "b <&>", "large") is None
