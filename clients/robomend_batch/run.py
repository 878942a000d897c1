"""All logs of a run: each file is a piece of work, and a file that is done is not done again."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from heapq import heappop, heappush
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from shutil import copyfileobj
from typing import Any

from robomend_batch.answers import FAULTY
from robomend_batch.errors import FULL, DiskFull
from robomend_batch.manifest import alone_in, keep_parts, open_manifest, write_beside
from robomend_batch.observing import digest
from robomend_batch.one_log import RESULTS, Record, Setup
from robomend_batch.parts import COLUMNS, PIECE, WRITTEN, schema
from robomend_batch.pool import Share, in_this_process, in_workers
from robomend_batch.progress import Progress
from robomend_batch.starting import Started
from robomend_batch.unfinished import stamp


class Joined:
    """OUT/results.ndjson: the lines of all logs in the order of their names.

    They are joined while the rest is diagnosed: what comes before all that is still to be done can be
    joined already.

        a.bag  b.bag  c.bag  d.bag
        done   done   …      done          a and b are joined now, d when c is

    The first lines are a file that is renamed, not copied: for a run over one log these are mostly all.
    """

    def __init__(self, out: Path, left: Iterable[str]) -> None:
        """`left`: the names of the files that are still to be done."""
        self._file = out / "results.ndjson"
        self._beside = self._file.with_name("results.ndjson.tmp")
        self._parts = out / RESULTS
        self._left = sorted(left, reverse=True)
        self._done: set[str] = set()
        self._waiting: list[tuple[str, tuple[str, ...]]] = []
        self._beside.unlink(missing_ok=True)

    def add(self, records: Iterable[Record]) -> None:
        """Take in the records of logs that are done."""
        for record in records:
            heappush(self._waiting, (str(record["log"]), tuple(record["parts"])))

    def finished(self, name: str, records: Iterable[Record]) -> None:
        """Take in the records of a file that was still to be done, and join what can be."""
        self.add(records)
        self._done.add(name)
        while self._left and self._left[-1] in self._done:
            self._done.remove(self._left.pop())
        while self._waiting and (not self._left or self._waiting[0][0] < self._left[-1]):
            self._join(heappop(self._waiting)[1])

    def close(self) -> None:
        """Join what is left, and rename it all."""
        while self._waiting:
            self._join(heappop(self._waiting)[1])
        self._beside.touch()
        os.replace(self._beside, self._file)

    def _join(self, parts: Iterable[str]) -> None:
        for part in parts:
            piece = (self._parts / part).with_suffix(PIECE)
            if not self._beside.exists() and piece.exists():
                os.replace(piece, self._beside)
                continue
            with self._beside.open("ab") as file:
                if piece.exists():
                    with piece.open("rb") as lines:  # a buffer of 1 MB would be new memory for each of them
                        copyfileobj(lines, file)
                    piece.unlink()
                else:  # of an earlier run
                    file.write(_lines_of(self._parts / part))


def _lines_of(part: Path) -> memoryview:
    import polars as pl

    text = BytesIO()  # so that a full disk is an OSError with its number
    pl.read_parquet(part).write_ndjson(text)
    return text.getbuffer()


@dataclass(frozen=True, slots=True)
class Summary:
    """What became of a run."""

    records: list[Record]

    @property
    def faulty(self) -> bool:
        """Whether any log shows a fault, or what the model cannot explain."""
        return any(record["intervals"].get(state) for record in self.records for state in FAULTY)

    @property
    def bad(self) -> list[Record]:
        """The logs with something wrong."""
        return [record for record in self.records if record["state"] not in ("ok", "unchecked")]

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
        "columns": COLUMNS,
        **({} if setup.together_s is None else {"together": str(setup.together_s)}),
        **({} if setup.log_timeout_s is None else {"log_timeout": str(setup.log_timeout_s)}),
    }


def run(
    setup: Setup,
    names: list[str],
    *,
    overwrite: bool = False,
    ndjson: bool = True,
    parquet: bool = False,
    workers: int = 0,
    scheduler: str | None = None,
    begun: list[Started] | None = None,
    progress: Callable[[int, int], Progress] = Progress,
) -> Summary:
    """Diagnose logs into a folder.

    Args:
        setup: model, options, folder.
        names: of the files.
        overwrite: replace the results of another run.
        ndjson: write results.ndjson as well.
        parquet: write results.parquet as well.
        workers: processes; 0: none but this one.
        scheduler: the address of a Dask cluster, in place of them.
        begun: workers that are there already.
        progress: made with the number of files and their bytes.

    Raises:
        AnotherRun: the folder holds something else.
        SchedulerFailed: the cluster cannot do it; the same call goes on.
        DiskFull: the results cannot be written; the same call goes on.
    """
    with alone_in(setup.out):
        try:
            summary = _run(setup, names, overwrite, ndjson, workers, scheduler, begun, progress)
            _write_parquet(setup.out, summary.records, parquet)
            return summary
        except OSError as error:
            if error.errno in FULL:
                raise DiskFull(f"{setup.out}: {error.strerror}") from error
            raise


def _run(
    setup: Setup,
    names: list[str],
    overwrite: bool,
    ndjson: bool,
    workers: int,
    scheduler: str | None,
    begun: list[Started] | None,
    progress: Callable[[int, int], Progress],
) -> Summary:
    manifest = open_manifest(setup.out, settings_of(setup), setup.system.source, names, overwrite=overwrite)
    left = [name for name in names if not manifest.done(name)]
    stamps = {name: stamp(name) for name in left}  # before they are read
    shown = progress(len(left), sum(size for size, _ in stamps.values()))
    lost: list[Record] = []
    joined = Joined(setup.out, left) if ndjson else None
    if joined is not None:
        joined.add(manifest.records_without(left))
    try:
        done = _diagnosed(
            replace(setup, ndjson=ndjson),
            left,
            workers,
            scheduler,
            lambda name, share: shown.reading(name, share, stamps[name][0]),
            begun,
        )
        for name, records in done:
            if not any(record["state"] == "lost" for record in records):  # the same command tries those again
                manifest.finish(name, stamps[name], records)
            else:
                lost += records
            if joined is not None:
                joined.finished(name, records)
            shown.finished(name, stamps[name][0])
            for record in records:
                for problem in record["problems"]:
                    many = f" ({problem['count']} times)" if problem["count"] > 1 else ""
                    shown.say(f"{record['state']}: {problem['place']}: {problem['reason']}{many}")
    finally:
        shown.close()
        manifest.write()
    records = sorted([*manifest.records, *lost], key=lambda record: str(record["log"]))
    keep_parts(setup.out, frozenset(part for record in records for part in record["parts"]))
    lines = [json.dumps(record, ensure_ascii=False, separators=(",", ":")) + "\n" for record in records]
    write_beside(setup.out / "logs.ndjson", "".join(lines).encode("utf-8", "surrogateescape"))
    if joined is not None:
        joined.close()
    else:
        (setup.out / "results.ndjson").unlink(missing_ok=True)
    return Summary(records)


def _diagnosed(
    setup: Setup,
    names: list[str],
    workers: int,
    scheduler: str | None,
    on_share: Share,
    begun: list[Started] | None,
) -> Iterator[tuple[str, list[Record]]]:
    if scheduler is not None and names:
        from robomend_batch.cluster import in_cluster  # of the extra `dask`

        return in_cluster(setup, names, scheduler)
    if not workers:
        return in_this_process(setup, names, on_share)
    return in_workers(setup, names, workers, on_share, begun)


def _write_parquet(out: Path, records: list[Record], wanted: bool) -> None:
    """Write all intervals as results.parquet, part by part, in the order of the logs."""
    results = out / "results.parquet"
    parts = [out / RESULTS / part for record in records for part in record["parts"]]
    if not wanted:
        results.unlink(missing_ok=True)
        return
    import polars as pl

    beside = results.with_name("results.parquet.tmp")
    frames = pl.scan_parquet(parts, glob=False) if parts else pl.LazyFrame(schema=schema())
    try:
        frames.sink_parquet(beside, **WRITTEN)
    except pl.exceptions.PolarsError as error:  # it has the number of the system's error in its text only
        number = re.search(r"os error (\d+)", str(error))
        if number is None:
            raise
        raise OSError(int(number[1]), os.strerror(int(number[1]))) from error
    os.replace(beside, results)
