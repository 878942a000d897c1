"""The command `robomend-bench isolability`: all faults of a robot against all, and what would split them.

The robots are those of robots-v1 (robomend_bench.generator). What is at hand is drawn by the seed: all that
the rules speak of; what robots-v1 observes (all but three topics of ten); or only three topics of ten, where
most faults are alike or unseen and further observables have to be looked for. Each run starts with a fresh
model: the median of the runs is told, with the first one, and the processor time.
"""

from __future__ import annotations

import json
import random
import statistics
import time
from typing import Any

import click

from robomend.diagnosis.isolability.analysis import isolability
from robomend_bench.generator import OBSERVED_SHARE, Robot, make_robot
from robomend_client.literals import Atom

FEW = 0.3
"""The share of topics that are observed where nothing else is."""


@click.command("isolability")
@click.option("--only", multiple=True, type=int, help="Components; repeatable.  [default: 100, 1000]")
@click.option("--seed", default=1, show_default=True)
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1, 100))
@click.option("--double", is_flag=True, help="Compare double faults, too.")
@click.option("--timeout", default=300.0, show_default=True, help="Of each analysis, in seconds.")
@click.option("--format", "output", type=click.Choice(["markdown", "json"]), default="markdown")
def command(
    only: tuple[int, ...], seed: int, repeats: int, double: bool, timeout: float, output: str
) -> None:
    """Measure which faults can be detected and told apart, on generated robots."""
    rows = [
        _measured(size, seed, at_hand, repeats, double, timeout)
        for size in only or (100, 1000)
        for at_hand in ("all", "robots-v1", "few topics")
    ]
    if output == "json":
        click.echo(json.dumps(rows))
        return
    head = ("components", "at hand", "median s", "first s", "processor s", "detected", "groups", "complete")
    click.echo(f"| {' | '.join(head)} |\n|{' --- |' * len(head)}")
    for row in rows:
        click.echo(f"| {' | '.join(str(row[name]) for name in head)} |")


def _measured(
    size: int, seed: int, at_hand: str, repeats: int, double: bool, timeout_s: float
) -> dict[str, Any]:
    times, processor = [], []
    for _ in range(repeats):
        robot = make_robot(size, seed)
        observed = _observed(robot, at_hand, seed)
        began, spent = time.perf_counter(), time.process_time()
        found = isolability(robot.cnf, observed, double=double, timeout_s=timeout_s)
        times.append(time.perf_counter() - began)
        processor.append(time.process_time() - spent)
    return {
        "components": size,
        "at hand": at_hand,
        "median s": round(statistics.median(times), 3),
        "first s": round(times[0], 3),
        "processor s": round(statistics.median(processor), 3),
        "detected": sum(1 for known in found.detectable if known),
        "groups": len(found.ambiguities),
        "complete": found.complete,
    }


def _observed(robot: Robot, at_hand: str, seed: int) -> list[Atom]:
    chance = random.Random(f"isolability {len(robot.cnf.components)} {seed}")
    topics = {atom for atom in robot.cnf.atoms if atom.predicate == "ok"}
    if at_hand == "all":
        return list(robot.cnf.atoms)
    share = OBSERVED_SHARE if at_hand == "robots-v1" else FEW
    some = [topic for topic in sorted(topics) if chance.random() < share]
    return some if at_hand == "few topics" else [*(set(robot.cnf.atoms) - topics), *some]
