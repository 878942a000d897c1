"""A folder of results, read again: for reports, queries and comparisons."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robomend.errors import InputError
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend_batch.manifest import Manifest, read_manifest
from robomend_batch.one_log import RESULTS, Record
from robomend_batch.parts import schema
from robomend_client.counts import counted
from robomend_client.observers.base import SECOND

if TYPE_CHECKING:
    import polars as pl

Bad = tuple[tuple[str, ...], ...]
"""The diagnoses of an interval: the components of each."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A row of the results."""

    segment: int
    start_ns: int
    end_ns: int
    state: str
    bad: Bad
    observations: tuple[str, ...]

    @property
    def span_ns(self) -> int:
        return self.end_ns - self.start_ns


class Results:
    """See the module."""

    def __init__(self, out: Path) -> None:
        """
        Raises:
            InputError: the folder holds no results.
        """
        self.out = out
        self.manifest: Manifest = read_manifest(out)
        self.records: list[Record] = self.manifest.records

    def choose(self, patterns: Sequence[str]) -> None:
        """Leave only the logs that have one of these names, or fit one as a pattern.

        Raises:
            InputError: no log fits one of them.
        """
        chosen: set[str] = set()
        for pattern in patterns:
            fits = {record["log"] for record in self.records if _fits(record["log"], pattern)}
            if not fits:
                raise InputError(f"no log of {self.out} is called {pattern!r}; logs.ndjson has their names")
            chosen |= fits
        self.records = [record for record in self.records if record["log"] in chosen]

    @property
    def system(self) -> System:
        """The model that they were made with."""
        return load_text(self.manifest.source, name="model", file=str(self.out / "manifest.json"))

    def files(self) -> list[Path]:
        """Return the parts, in the order of the logs."""
        return [self.out / RESULTS / part for record in self.records for part in record["parts"]]

    def scan(self) -> pl.LazyFrame:
        """Return all intervals as a table."""
        import polars as pl

        files = self.files()
        return pl.scan_parquet(files, glob=False) if files else pl.LazyFrame(schema=schema())

    def intervals(self, record: Record) -> Iterator[Interval]:
        """Yield the intervals of a log, part by part."""
        import polars as pl

        wanted = ["segment", "start_ns", "end_ns", "state", "bad", "observations"]
        for part in record["parts"]:
            try:
                frame = pl.read_parquet(self.out / RESULTS / part, columns=wanted)
            except (pl.exceptions.PolarsError, OSError) as error:
                raise InputError(f"{self.out / RESULTS / part} is gone or damaged: run again") from error
            for segment, start, end, state, bad, observations in frame.iter_rows():
                yield Interval(segment, start, end, state, bad_of(bad), tuple(observations))


def _fits(log: str, pattern: str) -> bool:
    """Whether a log has this name, from its beginning or from any of its folders on."""
    return log == pattern or any(fnmatchcase(log, either) for either in (pattern, f"*/{pattern}"))


def bad_of(bad: Iterable[Iterable[str]] | None) -> Bad:
    """Return the diagnoses of a row as a value."""
    return tuple(tuple(one) for one in bad or ())


def told(bad: Bad, most: int = 4) -> str:
    """Return diagnoses in words: `hokuyo, or hokuyo_node`."""
    words = [" with ".join(one) or "nothing" for one in bad[:most]]
    more = f" (and {counted(len(bad) - most, 'other')})" if len(bad) > most else ""
    return ", or ".join(words) + more


def short_times(span_ns: int) -> str:
    """Return a span for people: `0.3 s`, `12.5 s`, `3 min 20 s`, `2 h 5 min`."""
    seconds = span_ns / 1e9
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def moment(time_ns: int, timespec: str = "seconds") -> str:
    """Return a time for people, in UTC: `2026-11-23 12:30:01`; timespec as of `datetime.isoformat`."""
    seconds, rest_ns = divmod(time_ns, SECOND)
    try:
        at = datetime.fromtimestamp(seconds, UTC).replace(microsecond=rest_ns // 1000, tzinfo=None)
        return at.isoformat(" ", timespec)
    except (ValueError, OSError, OverflowError):
        return f"{seconds} s"


def record_span_ns(record: Record, *states: str) -> int:
    """Return how long a log was in these states; in any, if none is named."""
    spans: dict[str, Any] = record["span_ns"]
    return sum(spans.values()) if not states else sum(spans.get(state, 0) for state in states)
