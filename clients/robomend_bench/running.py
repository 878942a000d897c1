"""Runs a suite: one process a contender, questions interleaved, so that what slows one down slows down all.

    for each group
        start the contenders, each in its process      building is not measured, but reported
        warm-up: the first question twice and the last one, unmeasured; who runs out of time is not warm
        for each repeat, for each question
            ask each contender in turn, in an order that rotates; quick ones run up with the first question

A contender that ran out of time on a question is not asked that question again; where it did so as it was
warmed up, it is asked once more, which counts.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

from robomend_bench.results import Built, Run, Sample, Status, disagreements, now, this_machine
from robomend_bench.suite import Answer, Group, Suite, Wish
from robomend_bench.tables import too_dear
from robomend_bench.worker import Contestant

WARM_UP = (0, 0, -1)
"""Questions before the first that counts: some structures are built at the second use, when they pay off,
and some when a hard question needs them, as the last one may be. Modes once and cold tell what that takes."""

Progress = Callable[[str, int, int], None]
"""Called with what is running now, questions asked so far and in all."""


def run_suite(
    suite: Suite,
    wish: Wish,
    contenders: tuple[str, ...] = (),
    *,
    repeats: int = 3,
    command: str = "",
    progress: Progress = lambda what, done, total: None,
) -> Run:
    """Return the measurements of one suite in one mode.

    Raises:
        InputError: the wish names groups, data or contenders that are not there.
    """
    names = contenders or suite.contenders(wish.mode)
    names = (*names, *(external.name for external in wish.external if external.name not in names))
    machine, started = this_machine(), now()
    samples: list[Sample] = []
    built: list[Built] = []
    groups = list(suite.groups(wish))
    total = sum(len(group.questions) for group in groups) * len(names) * repeats
    asked = 0

    def step(what: str, count: int = 1) -> None:
        nonlocal asked
        asked += count
        progress(what, asked, total)

    for group in groups:
        progress(group.name, asked, total)
        with ExitStack() as stack:
            contestants = [Contestant(suite.name, name, group, wish) for name in names]
            for contestant in contestants:
                stack.callback(contestant.close)
            samples += _measure(group, contestants, repeats, step)
            built += [Built(group.name, c.name, c.build_s, c.base_mib, c.peak_mib) for c in contestants]
    return Run(
        suite=suite.name,
        version=suite.version,
        mode=wish.mode,
        command=command,
        seed=wish.seed,
        contenders=names,
        machine=machine,
        started=started,
        clock=wish.clock,
        timeout_s=wish.timeout_s,
        samples=tuple(samples),
        built=tuple(built),
        disagreements=(*disagreements(samples), *too_dear(samples)),
    )


def _measure(
    group: Group, contestants: list[Contestant], repeats: int, step: Callable[[str, int], None]
) -> list[Sample]:
    samples: list[Sample] = []
    out_of_time: set[tuple[str, int]] = set()
    for contestant in contestants:
        step(f"{group.name} · starting {contestant.name}", 0)
        late: set[int] = set()
        for index in WARM_UP:
            which = index % len(group.questions)
            if which not in late and contestant.ask(which)[0] != "ok":
                late.add(which)
    for repeat in range(repeats):
        for index in range(len(group.questions)):
            turn = (index + repeat) % len(contestants)
            for contestant in contestants[turn:] + contestants[:turn]:
                step(f"{group.name} · {contestant.name}", 1)
                if (contestant.name, index) in out_of_time:
                    continue
                status, answer, seconds, note = contestant.ask(index)
                if status != "ok":
                    out_of_time.add((contestant.name, index))
                samples.append(_sample(group, index, contestant.name, repeat, status, answer, seconds, note))
    return samples


def _sample(
    group: Group,
    index: int,
    contender: str,
    repeat: int,
    status: Status,
    answer: Answer | None,
    seconds: float,
    note: str,
) -> Sample:
    return Sample(
        group=group.name,
        size=group.size,
        question=group.questions[index].name,
        contender=contender,
        repeat=repeat,
        status=status,
        seconds=seconds,
        result=answer.result if answer is not None and status == "ok" else None,
        shown=answer.shown if answer is not None else None,
        note=note,
        cost=answer.cost if answer is not None and status == "ok" else None,
        bound=answer.bound if answer is not None else 1.0,
    )
