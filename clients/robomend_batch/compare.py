"""`robomend-batch diff` and `compare`: two folders of results, and the logs of one.

differences   did a new model or other observers change a verdict, in which log, when?
groups        logs that show the same faults
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import click

from robomend.errors import InputError
from robomend_batch.answers import FAULTY
from robomend_batch.one_log import Record
from robomend_batch.report_command import OUT
from robomend_batch.results import Bad, Interval, Results, moment, short_times, told
from robomend_client.counts import counted

FORMAT = click.option(
    "--format", "format_", type=click.Choice(("table", "ndjson")), default="table", show_default=True
)


@dataclass(frozen=True, slots=True)
class Difference:
    """A stretch of a log of which two runs say different things; None: one of them has nothing there."""

    log: str
    segment: int
    start_ns: int
    end_ns: int
    before: tuple[str, Bad] | None
    after: tuple[str, Bad] | None

    def json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {
            "log": self.log,
            "segment": self.segment,
            "start_ns": self.start_ns,
            "end_ns": self.end_ns,
            **{
                name: None if told is None else {"state": told[0], "bad": [list(bad) for bad in told[1]]}
                for name, told in (("before", self.before), ("after", self.after))
            },
        }


def differences(one: Results, other: Results) -> Iterator[Difference]:
    """Yield where two runs differ, in the order of the logs and of time.

    Raises:
        InputError: they have no log in common.
    """
    before = {record["log"]: record for record in one.records}
    after = {record["log"]: record for record in other.records}
    if not before.keys() & after.keys():
        raise InputError(f"{one.out} and {other.out} have no log in common")
    for log in sorted(before.keys() | after.keys()):
        yield from _of_log(log, _told(one, before.get(log)), _told(other, after.get(log)))


Segments = dict[int, list[Interval]]


def _told(results: Results, record: Record | None) -> Segments:
    if record is None:
        return {}
    return {n: list(some) for n, some in groupby(results.intervals(record), lambda one: one.segment)}


def _of_log(log: str, one: Segments, other: Segments) -> Iterator[Difference]:
    for segment in sorted(one.keys() | other.keys()):
        open_: Difference | None = None
        for start_ns, end_ns, before, after in _overlaid(one.get(segment, []), other.get(segment, [])):
            if before == after:
                continue
            if (
                open_ is not None
                and open_.end_ns == start_ns
                and (open_.before, open_.after) == (before, after)
            ):
                open_ = Difference(log, segment, open_.start_ns, end_ns, before, after)
                continue
            if open_ is not None:
                yield open_
            open_ = Difference(log, segment, start_ns, end_ns, before, after)
        if open_ is not None:
            yield open_


Verdict = tuple[str, Bad] | None


def _overlaid(one: list[Interval], other: list[Interval]) -> Iterator[tuple[int, int, Verdict, Verdict]]:
    """Yield the stretches between all borders of both, with what each says of them."""
    borders = sorted({at for some in (one, other) for each in some for at in (each.start_ns, each.end_ns)})
    places = [0, 0]
    for start_ns, end_ns in pairwise(borders):
        verdicts: list[Verdict] = []
        for which, some in enumerate((one, other)):
            while places[which] < len(some) and some[places[which]].end_ns <= start_ns:
                places[which] += 1
            here = some[places[which]] if places[which] < len(some) else None
            known = here is not None and here.start_ns <= start_ns
            verdicts.append((here.state, here.bad) if known and here is not None else None)
        yield start_ns, end_ns, verdicts[0], verdicts[1]


@dataclass(frozen=True, slots=True)
class Group:
    """Logs that show the same faults, and no others."""

    faults: tuple[Bad, ...]
    logs: tuple[str, ...]


def groups(results: Results) -> list[Group]:
    """Return the logs by what they show: the largest groups first, that without faults last."""
    found: dict[tuple[Bad, ...], list[str]] = {}
    for record in results.records:
        if record["state"] in ("refused", "lost"):
            continue
        shown = {interval.bad for interval in results.intervals(record) if interval.state in FAULTY}
        found.setdefault(tuple(sorted(shown)), []).append(record["log"])
    order = sorted(found.items(), key=lambda item: (not item[0], -len(item[1]), item[0]))
    return [Group(faults, tuple(logs)) for faults, logs in order]


@click.command("diff")
@click.argument("before", type=OUT)
@click.argument("after", type=OUT)
@FORMAT
@click.option("--fail-on-difference", is_flag=True, help="Exit with 1 if they differ.")
def diff(before: Path, after: Path, format_: str, fail_on_difference: bool) -> int:
    """Say where two folders of results differ: did a new model or other observers change a verdict?"""
    count = span_ns = 0
    logs = set()
    for found in differences(Results(before), Results(after)):
        count += 1
        span_ns += found.end_ns - found.start_ns
        logs.add(found.log)
        if format_ == "ndjson":
            click.echo(json.dumps(found.json(), ensure_ascii=False, separators=(",", ":")))
        else:
            begins = f"{moment(found.start_ns, 'milliseconds')} UTC"
            span = f"{begins} for {short_times(found.end_ns - found.start_ns)}"
            click.echo(f"{found.log}  {span}: {_words(found.before)} -> {_words(found.after)}")
    said = (
        f"{counted(count, 'difference')} in {counted(len(logs), 'log')}, {short_times(span_ns)}"
        if count
        else "no difference"
    )
    click.echo(said, err=True)
    return 1 if count and fail_on_difference else 0


def _words(verdict: Verdict) -> str:
    if verdict is None:
        return "nothing"
    if verdict[0] == "degraded":
        return f"{told(verdict[1])} (degraded)"
    return told(verdict[1]) if verdict[0] == "faulty" else verdict[0]


@click.command("compare")
@click.argument("out", type=OUT)
@FORMAT
def compare(out: Path, format_: str) -> int:
    """Group the logs in OUT by what they show: which have the same faults?"""
    for group in groups(Results(out)):
        if format_ == "ndjson":
            line = {
                "faults": [[list(bad) for bad in fault] for fault in group.faults],
                "logs": list(group.logs),
            }
            click.echo(json.dumps(line, ensure_ascii=False, separators=(",", ":")))
            continue
        shown = "; ".join(told(fault) or "what the model cannot explain" for fault in group.faults)
        click.echo(f"{shown or 'no fault'}: {counted(len(group.logs), 'log')}")
        for log in group.logs:
            click.echo(f"    {log}")
    return 0
