"""All logs of a run: each file is a piece of work, and a file that is done is not done again."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from typing import Any

from robomend.errors import BackendError
from robomend_batch.manifest import Manifest, keep_parts, open_manifest, stamp, write_beside
from robomend_batch.observing import digest
from robomend_batch.one_log import RESULTS, Diagnoser, Record, Setup
from robomend_batch.progress import Progress

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class DiskFull(BackendError):
    """Results cannot be written."""

    code = "disk-full"


@dataclass(frozen=True, slots=True)
class Summary:
    """What became of a run."""

    records: list[Record]

    @property
    def faulty(self) -> bool:
        """Whether any log shows a fault, or what the model cannot explain."""
        return any(
            record["intervals"].get(state) for record in self.records for state in ("faulty", "contradictory")
        )

    @property
    def bad(self) -> list[Record]:
        """The logs with something wrong."""
        return [record for record in self.records if record["state"] != "ok"]

    @property
    def lost(self) -> list[Record]:
        """The logs that no worker survived."""
        return [record for record in self.records if record["state"] == "lost"]


def settings_of(setup: Setup) -> dict[str, Any]:
    """Return what decides the results, beside the logs; compared when a run goes on."""
    options = setup.options
    return {
        "version": version("robomend"),
        "model": sha256(setup.system.source.encode()).hexdigest(),
        "minimal": options.minimal,
        "max_size": options.max_size,
        "limit": options.limit,
        "timeout_s": options.timeout_s,
        "unknown": setup.unknown,
        "observers": digest(setup.observers),
        "time": "header" if setup.by_header else "log",
    }


def run(
    setup: Setup,
    names: list[str],
    *,
    overwrite: bool = False,
    ndjson: bool = True,
    progress: Callable[[int, int], Progress] = Progress,
) -> Summary:
    """Diagnose logs into a folder.

    Raises:
        AnotherRun: the folder holds something else.
        DiskFull: the results cannot be written; the same call goes on.
    """
    manifest = open_manifest(setup.out, settings_of(setup), names, overwrite=overwrite)
    left = [name for name in names if not manifest.done(name)]
    sizes = {name: stamp(name)[0] for name in left}
    shown = progress(len(left), sum(sizes.values()))
    try:
        for name, stamped, records in _diagnosed(setup, left):
            manifest.finish(name, stamped, records)
            shown.finished(sizes[name])
            for record in records:
                for problem in record["problems"]:
                    many = f" ({problem['count']} times)" if problem["count"] > 1 else ""
                    shown.say(f"{record['state']}: {problem['place']}: {problem['reason']}{many}")
    except OSError as error:
        if error.errno in FULL:
            raise DiskFull(
                f"{setup.out}: {error.strerror}; make room, and the same command goes on"
            ) from error
        raise
    finally:
        shown.close()
        manifest.write()
    records = manifest.records
    keep_parts(setup.out, frozenset(part for record in records for part in record["parts"]))
    _write_lists(manifest, records, ndjson)
    return Summary(records)


def _diagnosed(setup: Setup, names: list[str]) -> Iterator[tuple[str, tuple[int, int], list[Record]]]:
    diagnoser = Diagnoser(setup)
    try:
        for name in names:
            stamped = stamp(name)
            yield name, stamped, diagnoser.diagnose(name)
    finally:
        diagnoser.close()


def _write_lists(manifest: Manifest, records: list[Record], ndjson: bool) -> None:
    """Write logs.ndjson, and all intervals as results.ndjson, in the order of the logs."""
    lines = [json.dumps(record, ensure_ascii=False, separators=(",", ":")) + "\n" for record in records]
    write_beside(manifest.out / "logs.ndjson", "".join(lines).encode("utf-8", "surrogateescape"))
    results = manifest.out / "results.ndjson"
    if not ndjson:
        results.unlink(missing_ok=True)
        return
    import polars as pl

    beside = results.with_name("results.ndjson.tmp")
    with beside.open("wb") as file:
        for record in records:
            for part in record["parts"]:
                pl.read_parquet(manifest.out / RESULTS / part).write_ndjson(file)
    os.replace(beside, results)
