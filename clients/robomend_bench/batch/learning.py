"""How good a model and observers are that were learned from healthy logs alone.

For each of the random robots of drives.py: learn from one healthy drive, diagnose another healthy one (every
fault that is told there is a false alarm) and one with planted faults.
"""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomend.errors import BackendError
from robomend_bench.batch import drives
from robomend_bench.batch.drives import BEGIN_S, Planted

AFTER_S = 60.0
"""So long after its end a fault may still be told: a window of the slowest topic."""

SECOND = 10**9


@dataclass
class Score:
    """What came out over all robots."""

    robots: int = 0
    held_h: float = 0.0
    false_alarms: int = 0  # in healthy drives
    stray: int = 0  # in drives with faults, outside of their times
    planted: Counter[str] = field(default_factory=Counter)
    found: Counter[str] = field(default_factory=Counter)  # told in its time, its component among the suspects
    alone: Counter[str] = field(
        default_factory=Counter
    )  # its component the one diagnosis of the longest interval
    delays_s: list[float] = field(default_factory=list)

    def json(self) -> dict[str, Any]:
        """Return all figures."""
        delays = sorted(self.delays_s)
        return {
            "robots": self.robots,
            "held_h": round(self.held_h, 2),
            "false_alarms": self.false_alarms,
            "stray": self.stray,
            "planted": dict(sorted(self.planted.items())),
            "found": dict(sorted(self.found.items())),
            "alone": dict(sorted(self.alone.items())),
            "delay_s": {"median": delays[len(delays) // 2], "longest": delays[-1]} if delays else None,
        }


def measure(program: list[str], folder: Path, seeds: range, minutes: float) -> Score:
    """Return the score over robots; each drive lasts so many minutes.

    Args:
        program: the command line of robomend-batch.
        folder: for the drives.
        seeds: of the robots.
        minutes: of each drive.
    """
    score = Score()
    for seed in seeds:
        mine = folder / f"robot{seed}"
        mine.mkdir()
        of = drives.robot(seed)
        good, held, faulty = (mine / f"{name}.bag" for name in ("good", "held", "faulty"))
        length_s = 60 * minutes
        drives.write(good, of, 3 * seed, length_s)
        drives.write(held, of, 3 * seed + 1, length_s)
        planted = drives.faults(of, seed, length_s)
        drives.write(faulty, of, 3 * seed + 2, length_s, planted)
        _run([*program, "learn", str(good), "-o", str(mine / "draft"), "--quiet"])
        out = mine / "out"
        model, observers = mine / "draft" / "model.yaml", mine / "draft" / "observers.yaml"
        _run(
            [
                *(*program, "run", str(held), str(faulty), "-m", str(model), "-o", str(out)),
                *("--observers", str(observers), "--quiet", "--workers", "0"),
            ]
        )
        told = [json.loads(line) for line in (out / "results.ndjson").read_text().splitlines()]
        score.robots += 1
        score.held_h += minutes / 60
        score.false_alarms += len(episodes([one for one in told if one["log"] == str(held)]))
        rate(score, [one for one in told if one["log"] == str(faulty)], planted)
        for log in (good, held, faulty):
            log.unlink()
    return score


def rate(score: Score, told: list[dict[str, Any]], planted: list[Planted]) -> None:
    """Add what was told of a drive with faults."""
    told_s = episodes(told)
    for fault in planted:
        score.planted[fault.kind] += 1
        here = [
            (start_s, end_s, bad)
            for start_s, end_s, bad in faulty(told)
            if end_s > fault.start_s and start_s < fault.end_s + AFTER_S
        ]
        named = [one for one in here if any(fault.node in diagnosis for diagnosis in one[2])]
        if named:
            score.found[fault.kind] += 1
            score.delays_s.append(max(0.0, named[0][0] - fault.start_s))
            longest = max(here, key=lambda one: one[1] - one[0])
            score.alone[fault.kind] += longest[2] == [[fault.node]]
    for start_s, end_s in told_s:
        if not any(end_s > fault.start_s and start_s < fault.end_s + AFTER_S for fault in planted):
            score.stray += 1


def faulty(told: list[dict[str, Any]]) -> list[tuple[float, float, list[list[str]]]]:
    return [
        (one["start_ns"] / SECOND - BEGIN_S, one["end_ns"] / SECOND - BEGIN_S, one["bad"])
        for one in told
        if one["state"] in ("faulty", "contradictory")
    ]


def episodes(told: list[dict[str, Any]]) -> list[tuple[float, float]]:
    """Return stretches in which any fault is told."""
    found: list[tuple[float, float]] = []
    for start_s, end_s, _ in faulty(told):
        if found and start_s <= found[-1][1]:
            found[-1] = found[-1][0], max(end_s, found[-1][1])
        else:
            found.append((start_s, end_s))
    return found


def _run(line: list[str]) -> None:
    done = subprocess.run(line, capture_output=True, text=True, timeout=1800, check=False)
    if done.returncode:
        raise BackendError(f"{' '.join(line[3:])} ended with {done.returncode}: {done.stderr[-500:]}")
