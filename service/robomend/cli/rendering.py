"""Answers of `robomend diagnose`: one compact JSON object, or a table for people."""

from __future__ import annotations

import json
from collections.abc import Sequence

from robomend.diagnosis.explanations import what_was_learned
from robomend.diagnosis.result import DiagnosisResult, Factor

HEALTHY = '{"diagnoses":[{"bad":[],'
"""How the object of a healthy set begins."""

SHOWN = 20
"""Conflicts, healthy suspects and lessons that the table lists; JSON has all of them."""


class Renderer:
    """Results of one model as JSON text; `elapsed_s` stands last."""

    def __init__(self, components: Sequence[str], *, factored: bool) -> None:
        self._quoted = {name: json.dumps(name, ensure_ascii=False) for name in components}
        self._factored = factored

    def __call__(self, result: DiagnosisResult) -> str:
        """Return the object. `good` makes it long, so that it is put together from quoted names."""
        quoted = self._quoted
        diagnoses = []
        for diagnosis in result.diagnoses:
            bad = ",".join([quoted[name] for name in diagnosis.bad])
            out = set(diagnosis.bad)
            good = ",".join([text for name, text in quoted.items() if name not in out])
            more = f',"modes":{_compact(dict(diagnosis.modes))}' if diagnosis.modes else ""
            more += f',"resolves":{_compact(diagnosis.resolves)}'
            probability = json.dumps(diagnosis.probability)
            diagnoses.append(f'{{"bad":[{bad}],"good":[{good}],"probability":{probability}{more}}}')
        conflicts = [
            {
                "components": conflict.components,
                "observations": [str(literal) for literal in conflict.observations],
                "rules": conflict.rules,
                "text": conflict.text,
            }
            | ({} if conflict.minimal else {"minimal": False})
            for conflict in result.conflicts
        ]
        learned = what_was_learned(result.conflicts, result.learned)
        extra = f',"learned":{_compact(learned)},"cleared":{_compact(dict(result.cleared))}'
        if not result.conflicts_complete:
            extra += ',"conflicts_complete":false'
        if self._factored or result.factored:
            factored = [
                [
                    {"component": f.component, "alternatives": f.alternatives}
                    | ({"sets": f.sets} if f.sets else {})
                    for f in product
                ]
                for product in result.factored
            ]
            extra += f',"factored":{_compact(factored)},"count":{_compact(result.count)}'
        return (
            f'{{"diagnoses":[{",".join(diagnoses)}],"complete":{_compact(result.complete)},'
            f'"stopped_by":{_compact(result.stopped_by)},"conflicts":{_compact(conflicts)}{extra},'
            f'"elapsed_s":{result.elapsed_s:.6f}}}'
        )


def _compact(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def show(result: DiagnosisResult) -> None:
    """Write one answer for people."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(highlight=False, soft_wrap=True)
    if result.healthy:
        console.print("[green]healthy[/]: this is what a robot without fault would show")
    elif not result.diagnoses:
        console.print("no diagnosis found")
    else:
        ranked = any(diagnosis.probability is not None for diagnosis in result.diagnoses)
        probable = ["probability"] if ranked else []
        table = Table("#", "bad", *probable, "resolves conflicts", box=None, pad_edge=False)
        for number, diagnosis in enumerate(result.diagnoses, 1):
            parts = [f"{c} ({diagnosis.modes[c]})" if c in diagnosis.modes else c for c in diagnosis.bad]
            probability = "" if diagnosis.probability is None else f"{diagnosis.probability:.4f}"
            hit = [str(index + 1) for index in diagnosis.resolves[:SHOWN]]
            more = "…" if len(diagnosis.resolves) > SHOWN else ""
            cells = [str(number), escape(", ".join(parts)), *([probability] if ranked else [])]
            table.add_row(*cells, " ".join(hit) + more)
        console.print(table)
    for product in result.factored[:SHOWN]:
        console.print(escape(" × ".join(map(_braces, product))))
    if len(result.factored) > SHOWN:
        console.print(f"[dim]and {len(result.factored) - SHOWN} more products: see --format json[/]")
    if result.count is not None:
        listed = f", {len(result.diagnoses)} of them listed" if result.stopped_by == "limit" else ""
        console.print(f"{result.count} in all{listed}")
    sentences = [f"conflict {number}: {c.text}" for number, c in enumerate(result.conflicts, 1)]
    lessons = what_was_learned(result.conflicts, result.learned)
    sentences_of = {
        "conflicts": sentences,
        "lessons": [f"learned from {literal}: {text}" for literal, text in lessons.items()],
        "healthy suspects": [f"healthy in 1: {name}, as {why}" for name, why in result.cleared.items()],
    }
    for what, lines in sentences_of.items():
        for line in lines[:SHOWN]:
            console.print(escape(line))
        if len(lines) > SHOWN:
            console.print(f"[dim]and {len(lines) - SHOWN} more {what}: see --format json[/]")
    if not result.conflicts_complete:
        console.print("[dim]there was no time, or no room, for all conflicts that the diagnoses rest on[/]")
    ending = "complete" if result.complete else f"incomplete: stopped by {result.stopped_by}"
    if result.stopped_by == "limit" and result.factored and result.count is not None:
        ending = "the list is stopped by limit, the products are complete"
    console.print(f"[dim]{ending}; {result.elapsed_s * 1000:.1f} ms[/]")


def _braces(factor: Factor) -> str:
    """Return the choices of a factor, e.g. `{a, b + c}`."""
    choices = [" + ".join(choice) for choice in factor.choices[:SHOWN]]
    if len(factor.choices) > SHOWN:
        choices.append(f"{len(factor.choices) - SHOWN} more")
    return "{" + ", ".join(choices) + "}"
