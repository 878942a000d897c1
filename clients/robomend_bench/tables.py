"""Runs as text: Markdown for docs and issues, and two runs side by side.

Plans are compared by cost: no answer is wrong, but one may be dearer than it promises. An answer with a
cost says by `bound` how many times the cost of the cheapest plan it may need. The cheapest plan is the
cheapest that any contender found for that question in that run: the proved optimum wherever an optimal
planner finished.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations
from math import inf
from statistics import geometric_mean, median

from robomend_bench.results import Line, Run, Sample, duels, ratio_at_least, slope, summarise
from robomend_bench.suite import ONE
from robomend_client.counts import counted

TOLERANCE = 1e-6
"""Costs are sums of the actions' costs, in floating point."""

Costs = dict[tuple[str, str], dict[str, float]]
"""(group, question) -> contender -> the dearest plan of all repeats."""


def costs(samples: Iterable[Sample]) -> Costs:
    """Return the costs of all answers that have one."""
    found: Costs = {}
    for sample in samples:
        if sample.status == "ok" and sample.cost is not None:
            of_question = found.setdefault((sample.group, sample.question), {})
            of_question[sample.contender] = max(sample.cost, of_question.get(sample.contender, 0.0))
    return found


def too_dear(samples: Iterable[Sample]) -> tuple[str, ...]:
    """Return, in words, which plans cost more than their contender promises."""
    known = list(samples)
    bounds = {sample.contender: sample.bound for sample in known}
    texts = []
    for (group, question), by_contender in costs(known).items():
        cheapest = min(by_contender.values())
        for contender, cost in by_contender.items():
            if cost > bounds[contender] * cheapest + TOLERANCE:
                texts.append(
                    f"{group}/{question}: {cost:g} by {contender}, {_times(cost, cheapest)} the cheapest "
                    f"known ({cheapest:g}); at most {bounds[contender]:g}× is promised"
                )
    return tuple(texts)


def comparisons(run: Run) -> list[str]:
    """Return a sentence for each group and pair of contenders: on how many questions costs are equal."""
    by_question = costs(run.samples)
    texts = []
    for group in run.groups:
        for first, second in combinations(run.contenders, 2):
            pairs = [
                (by_contender[first], by_contender[second])
                for (of_group, _), by_contender in by_question.items()
                if of_group == group and {first, second} <= by_contender.keys()
            ]
            if not pairs:
                continue
            equal = sum(abs(ours - theirs) <= TOLERANCE for ours, theirs in pairs)
            text = f"{group}: cost of {first} and {second} equal on {equal} of the {len(pairs)} both solved"
            if equal < len(pairs):
                ratios = [ours / theirs for ours, theirs in pairs if theirs > 0]
                text += f", else {min(ratios):.2f}× to {max(ratios):.2f}×"
            texts.append(f"{text} (together {_sum(pairs, 0)} and {_sum(pairs, 1)}).")
    return texts


def _times(cost: float, cheapest: float) -> str:
    return f"{cost / cheapest:.2f}×" if cheapest else "not"


def _sum(pairs: list[tuple[float, float]], position: int) -> str:
    return f"{sum(pair[position] for pair in pairs):g}"


def seconds(value: float | None) -> str:
    """Return a time with three digits and its unit, e.g. `4.7 µs`, `39.0 ms`, `1.20 s`."""
    if value is None:
        return "-"
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        scaled = value * factor
        if scaled >= 1 or unit == "µs":
            digits = 0 if scaled >= 99.5 else 1 if scaled >= 9.95 else 2
            return f"{scaled:.{digits}f} {unit}"
    raise AssertionError("unreachable")


def times(value: float | None) -> str:
    """Return a ratio with about three digits, e.g. `12.4×`."""
    if value is None:
        return "-"
    if value == inf:
        return "∞"
    return f"{value:.0f}×" if value >= 99.5 else f"{value:.1f}×" if value >= 9.95 else f"{value:.2f}×"


def markdown(run: Run) -> str:
    """Return a report of one run."""
    lines = summarise(run)
    shown = "size" if run.mode in ONE else _counted(run)
    head = ["group", "components", "contender", "solved", "median", "90 %", "worst", "PAR-2", shown]
    head.append("peak memory")
    against = len(run.contenders) > 1
    if against:
        head.insert(8, f"ratio to {run.contenders[0]}")
    rows = []
    for line in lines:
        row = [
            line.group,
            str(line.size),
            line.contender,
            f"{line.solved}/{line.asked}",
            seconds(line.median_s),
            seconds(line.most_s),
            seconds(line.worst_s),
            seconds(line.par2_s),
            line.shown or "-",
            f"{line.peak_mib:.0f} MiB" if line.peak_mib else "-",
        ]
        if against:
            row.insert(8, times(line.ratio) + _between(line.ratio_between))
        rows.append(row)
    parts = [
        f"## {run.suite} version {run.version}, {run.mode}",
        "",
        f"`{run.command}`" if run.command else "",
        "",
        _table(head, rows),
        "",
        *_against_the_fastest(run),
        *_remarks(run, lines),
        f"{CLOCKS[run.clock]}, the fastest of all repeats of a question, in the contender's own process;",
        f"medians, worst cases and ratios are over questions. {BUILDING.get(run.mode, WARM)}",
        "",
        machine_line(run),
    ]
    return "\n".join(parts) + "\n"


def _between(interval: tuple[float, float] | None) -> str:
    return f" ({times(interval[0])[:-1]}-{times(interval[1])[:-1]})" if interval is not None else ""


def _against_the_fastest(run: Run) -> list[str]:
    """Return the table that holds the first contender against the fastest other one of each group."""
    if len(run.contenders) < 3:
        return []
    found = duels(run)
    if not found:
        return []  # nobody else had an answer
    first = run.contenders[0]
    head = ["group", "fastest other", f"ratio to {first}", "of the 90 %", f"{first} is slower", "by at most"]
    rows = [
        [
            duel.group,
            duel.against,
            times(duel.ratio),
            times(duel.most_ratio),
            f"{duel.lost}/{duel.asked}",
            seconds(duel.lost_by_s) if duel.lost else "-",
        ]
        for duel in found
    ]
    lost, asked = sum(duel.lost for duel in found), sum(duel.asked for duel in found)
    whole = [duel for duel in found if 0 < duel.ratio < inf and 0 < duel.most_ratio < inf]
    parts = [_table(head, rows), ""]
    if len(whole) > 1:
        medians = times(geometric_mean(duel.ratio for duel in whole))
        most = times(geometric_mean(duel.most_ratio for duel in whole))
        parts += [
            f"Geometric means over groups: {medians}, of the 90th percentiles {most}. "
            f"Some other contender is faster than {first} on {lost} of {counted(asked, 'question')}.",
            "",
        ]
    return parts


def _remarks(run: Run, lines: Sequence[Line]) -> list[str]:
    remarks = []
    for contender in run.contenders:
        exponent = slope(run, contender)
        if exponent is not None and len(run.groups) > 2:
            remarks += [f"Growth of {contender}: median time ∝ components^{exponent:.2f}.", ""]
        times_of_all = run.best(contender).values()
        if times_of_all and len(run.groups) > 1:
            text = f"median {seconds(median(times_of_all))}, worst {seconds(max(times_of_all))}"
            remarks += [f"All groups, {contender}: {len(times_of_all)} solved, {text}.", ""]
    few = _few(run)
    if few:
        remarks += [f"Medians over questions with at most {FEW} {_counted(run)}: {'; '.join(few)}.", ""]
    for group in run.groups:
        for contender in run.contenders[1:]:
            bound = ratio_at_least(run, contender, group)
            if bound is not None:
                remarks += [
                    f"{contender} on {group}: the ratio is at least {times(bound[1])} when "
                    f"what it did not finish ({bound[0]}) counts with the time it spent in vain.",
                    "",
                ]
    if compared := comparisons(run):
        remarks += [*(f"- {text}" for text in compared), ""]
    for line in lines:
        if line.note:
            remarks += [f"Note: {line.contender} on {line.group}: {line.note}.", ""]
    if run.disagreements:
        remarks += [f"**{len(run.disagreements)} disagreements**, so that one contender is wrong:", ""]
        remarks += [*(f"- {text}" for text in run.disagreements[:20]), ""]
    elif len(run.contenders) > 1 and any(sample.result for sample in run.samples):
        remarks += ["All contenders gave the same answers.", ""]
    return remarks


def _counted(run: Run) -> str:
    """What the answers are made of."""
    return "steps" if run.suite == "plans" else "diagnoses"


FEW = 10
WARM = "Building the model is not included."
PREPARED = "Building the model, and what is found of it beforehand, is not included"
BUILDING = {
    "first": f"{PREPARED}; conflicts are left out.",
    "why": f"{PREPARED}; conflicts are told.",
    "few": "Building the model is not included, whatever is found of it later is; conflicts are told.",
    "once": "Each question was asked of a new engine, whose set-up is included; conflicts are left out.",
    "cold": "Reading the text and all that is built from it is included, for each question anew; conflicts "
    "are left out.",
    "cold-why": "Reading the text and all that is built from it is included, for each question anew; "
    "conflicts are told.",
    "structure": "Each question was asked of a new engine, whose set-up is included, with all that is found "
    "beforehand; conflicts are left out.",
}
CLOCKS = {"wall": "Times are wall-clock times", "cpu": "Times are CPU times of the process"}


def _few(run: Run) -> list[str]:
    """Return medians over questions with few diagnoses, where there are others too."""
    shown = {f"{s.group}/{s.question}": s.shown for s in run.samples if s.shown is not None}
    if run.mode in (*ONE, "check") or all(count <= FEW for count in shown.values()):
        return []
    texts = []
    for contender in run.contenders:
        for group in run.groups:
            chosen = [t for key, t in run.best(contender, group).items() if (shown.get(key) or 0) <= FEW]
            if chosen:
                texts.append(
                    f"{contender} on {group} {seconds(median(chosen))} ({counted(len(chosen), 'question')})"
                )
    return texts


def machine_line(run: Run) -> str:
    """Return when and where the run was made."""
    machine = run.machine
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    return (
        f"{run.started}, seed {run.seed}; {machine['cpu']}, {machine['cores']} cores, load "
        f"{machine['load']} at the start; {machine['system']}, Python {machine['python']}, {versions}."
    )


def comparison(old: Run, new: Run) -> str:
    """Return two runs side by side, over the questions that both solved."""
    head = ["group", "contender", "questions", "old median", "new median", "new / old"]
    head += ["only old", "only new"]
    rows = []
    for group in dict.fromkeys((*old.groups, *new.groups)):
        for contender in dict.fromkeys((*old.contenders, *new.contenders)):
            before, after = old.best(contender, group), new.best(contender, group)
            both = [key for key in before if key in after]
            if not before and not after:
                continue
            ratio = median(after[key] / before[key] for key in both if before[key] > 0) if both else None
            rows.append(
                [
                    group,
                    contender,
                    str(len(both)),
                    seconds(median(before[key] for key in both) if both else None),
                    seconds(median(after[key] for key in both) if both else None),
                    times(ratio),
                    str(len(before) - len(both)),
                    str(len(after) - len(both)),
                ]
            )
    changed = _changed_answers(old, new)
    parts = [
        f"## {old.suite}, {old.mode} → {new.suite}, {new.mode}",
        "",
        _table(head, rows),
        "",
        *(["**The answers differ:**", "", *(f"- {text}" for text in changed[:20]), ""] if changed else []),
        f"Old: {machine_line(old)}",
        "",
        f"New: {machine_line(new)}",
    ]
    return "\n".join(parts) + "\n"


def _changed_answers(old: Run, new: Run) -> list[str]:
    def answers(run: Run) -> dict[tuple[str, str], tuple[int | None, ...]]:
        return {(s.group, s.question): s.result for s in run.samples if s.status == "ok" and s.result}

    if (old.suite, old.mode, old.seed) != (new.suite, new.mode, new.seed):
        return []
    before, after = answers(old), answers(new)
    return [
        f"{group}/{question}: {before[group, question]} → {after[group, question]}"
        for group, question in before.keys() & after.keys()
        if before[group, question] != after[group, question]
    ]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    numeric = ["---" if name in ("group", "contender", "fastest other") else "---:" for name in head]
    body = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([f"| {' | '.join(head)} |", f"| {' | '.join(numeric)} |", *body])
