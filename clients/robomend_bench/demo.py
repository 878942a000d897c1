"""The command `robomend-bench demo`: the paper's scenarios again and again on a busy computer, acts counted.

    busy loops ──┐
    robomend demo, N times ──► demo.json ──► acts that were sent − acts that the fault calls for = needless

It is `robomend demo` as a user runs it: real processes, the emulated board, the service with its defaults.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from robomend_bench.faults.bench import busy
from robomend_bench.intervals import quantile, wilson

MOST_S = 600.0
"""Of one run; on a quiet computer it takes ten seconds."""

CALLED_FOR: Mapping[str, Counter[str]] = {
    "shut-down": Counter(["power_up(jaguar)", "stop_node(jaguar_node)", "start_node(jaguar_node)"])
}
"""What a scenario calls for. At power-up that is to switch on each device and to start each node, once."""


def sent(scenario: Mapping[str, Any]) -> list[str]:
    """Return the acts of a played scenario that were sent, in order; a retry is one more."""
    events = (event for event in scenario["events"] if event["kind"] == "action" and "index" in event)
    acts = {(e["repair"], e["index"]): str(e["text"]) for e in events if e["state"] == "running"}
    return list(acts.values())


def needless(name: str, acts: Sequence[str]) -> list[str]:
    """Return the acts beyond those that the scenario calls for."""
    called_for = CALLED_FOR.get(name) or Counter(
        {act: 1 for act in acts if act.startswith(("power_up(", "start_node("))}
    )
    return sorted((Counter(acts) - called_for).elements())


@click.command("demo", context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--runs", type=click.IntRange(1, 1000), default=10, show_default=True)
@click.option("--load", type=click.IntRange(0, 64), default=4, show_default=True, help="Busy loops beside.")
def command(runs: int, load: int) -> None:
    """Play the demo's two scenarios of the paper again and again, and count needless acts.

    Exit codes: 0 none, and every run was repaired; 1 not so.
    """
    played: list[tuple[str, bool, list[str], float]] = []
    with busy(load):
        for number in range(runs):
            click.echo(f"run {number + 1} of {runs}", err=True)
            played += [
                (one["name"], one["repaired"], needless(one["name"], sent(one)), one["figures"]["total_s"])
                for one in _play()
            ]
    click.echo("\n".join(report(played, load)))
    sys.exit(0 if all(repaired and not acts for _, repaired, acts, _ in played) else 1)


def _play() -> list[dict[str, Any]]:
    """Play the demo once; return its scenarios, as demo.json has them."""
    with tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        program = [sys.executable, "-c", "from robomend.cli.main import main; main()"]
        run = subprocess.run(
            [*program, "demo", "--format", "json", "--report", str(Path(folder) / "report")],
            capture_output=True,
            text=True,
            timeout=MOST_S,
        )
    if run.returncode != 0:
        raise click.ClickException(f"robomend demo ended with {run.returncode}: {run.stderr[-2000:]}")
    found: list[dict[str, Any]] = json.loads(run.stdout)["scenarios"]
    return found


def report(played: Sequence[tuple[str, bool, list[str], float]], load: int) -> list[str]:
    """Return the table of what was played: name, whether it was repaired, needless acts, seconds."""
    lines = [f"`robomend demo` beside {load} busy loops", ""]
    lines += ["| scenario | runs | repaired | with a needless act (95%) | seconds, median, most |"]
    lines += ["| --- | ---: | ---: | ---: | ---: |"]
    for name in dict.fromkeys(name for name, *_ in played):
        some = [one for one in played if one[0] == name]
        acted = sum(bool(acts) for _, _, acts, _ in some)
        low, high = wilson(acted, len(some))
        times = [seconds for *_, seconds in some]
        lines.append(
            f"| {name} | {len(some)} | {sum(repaired for _, repaired, _, _ in some)} "
            f"| {acted} ({100 * low:.0f}–{100 * high:.0f}%) | {quantile(times, 0.5):.1f}, {max(times):.1f} |"
        )
    lines += (f"\nneedless in {name}: {', '.join(acts)}" for name, _, acts, _ in played if acts)
    return lines
