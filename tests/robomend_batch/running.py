"""Runs of robomend-batch in tests, and what they leave."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from robomend.cli.commands import run
from robomend.resources import resource
from robomend_batch.commands import batch
from robomend_client.observers.base import SECOND

TEDUSAR = str(resource("examples", "tedusar.yaml"))
PROGRAM = [sys.executable, "-c", "from robomend_batch.main import main; main()"]


def batch_run(out: Path, *given: str | Path, model: str | Path = TEDUSAR) -> int:
    """Run in this process; return the exit code."""
    line = ["run", *map(str, given), "--model", str(model), "--out", str(out), "--quiet", "--workers", "0"]
    return run(line, batch)


def intervals(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "results.ndjson").read_text().splitlines()]


def spans(out: Path) -> list[tuple[float, float, str, Any]]:
    """Return start and end in seconds, state, and what is bad."""
    return [
        (one["start_ns"] / SECOND, one["end_ns"] / SECOND, one["state"], one["bad"]) for one in intervals(out)
    ]


def logs(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "logs.ndjson").read_text().splitlines()]


def tree(out: Path) -> dict[str, bytes]:
    """Return all that is in a folder of results."""
    return {
        str(file.relative_to(out)): file.read_bytes() for file in sorted(out.rglob("*")) if file.is_file()
    }


def ndjson(file: Path, *lines: tuple[float, str]) -> Path:
    """Write a log of times in seconds and literals."""
    text = [json.dumps({"time": round(time * SECOND), "literal": said}) for time, said in lines]
    file.write_text("\n".join(text) + "\n")
    return file
