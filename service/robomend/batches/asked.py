"""What is asked for: the options of a batch, and the command line of robomend-batch that does it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from robomend.batches.folders import BatchFolder
from robomend.store.records import Json

TOGETHER = re.compile(r"log|[0-9]{1,8}(\.[0-9]{1,6})?(s|min|h)")


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """The options of `robomend-batch run`, as far as who asks over HTTP chooses them."""

    minimal: Literal["subset", "cardinality"] = "subset"
    max_size: int | None = None
    limit: int = 100  # 0: none
    timeout_s: float = 5.0  # of a state
    unknown: Literal["refuse", "keep"] = "refuse"
    time: Literal["log", "header"] = "log"
    together: str | None = None  # as TOGETHER

    def json(self) -> Json:
        """Return them as they are kept."""
        return {name: getattr(self, name) for name in self.__slots__}


def run_arguments(options: Json, folder: BatchFolder, names: Sequence[str], workers: int) -> list[str]:
    """Return the arguments of the run; each time the same, so that it goes on where it was."""
    found = ["run", "--model", str(folder.model), "--out", str(folder.out), "--parquet", "--no-code"]
    if folder.observers.exists():
        found += ["--observers", str(folder.observers)]
    found += ["--minimal", options["minimal"], "--limit", str(options["limit"])]
    found += ["--timeout", str(options["timeout_s"]), "--unknown", options["unknown"]]
    found += ["--time", options["time"], "--workers", str(min(workers, len(names)))]
    if options["max_size"] is not None:
        found += ["--max-size", str(options["max_size"])]
    if options["together"] is not None:
        found += ["--together", options["together"]]
    return [*found, "--", *names]


def report_arguments(folder: BatchFolder) -> list[str]:
    """Return the arguments that write the report."""
    return ["report", str(folder.out)]
