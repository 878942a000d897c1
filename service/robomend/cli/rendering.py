"""Answers of `robomend diagnose` for people."""

from __future__ import annotations

from robomend.diagnosis.explanations import what_was_learned
from robomend.diagnosis.result import DiagnosisResult

SHOWN = 20
"""Conflicts, healthy suspects and lessons that the table lists; JSON has all of them."""


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
    for product in result.factored:
        console.print(" × ".join("{" + escape(", ".join(f.alternatives)) + "}" for f in product))
    if result.count is not None:
        console.print(f"{result.count} in all")
    sentences = [f"conflict {number}: {c.text}" for number, c in enumerate(result.conflicts, 1)]
    lessons = what_was_learned(result.conflicts)
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
    ending = "complete" if result.complete else f"incomplete: stopped by {result.stopped_by}"
    console.print(f"[dim]{ending}; {result.elapsed_s * 1000:.1f} ms[/]")
