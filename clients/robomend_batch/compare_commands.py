"""`robomend-batch diff` and `compare`: two folders of results; the logs of one."""

from __future__ import annotations

import json
from pathlib import Path

import click

from robomend_batch.report_command import OUT
from robomend_client.counts import counted

FORMAT = click.option(
    "--format", "format_", type=click.Choice(("table", "ndjson")), default="table", show_default=True
)


@click.command("diff")
@click.argument("before", type=OUT)
@click.argument("after", type=OUT)
@click.option(
    "--format", "format_", type=click.Choice(("table", "ndjson")), default="table", show_default=True
)
@click.option("--fail-on-difference", is_flag=True, help="Exit with 1 if they differ.")
def diff(before: Path, after: Path, format_: str, fail_on_difference: bool) -> int:
    """Say where two folders of results differ: did a new model or other observers change a verdict?"""
    from robomend_batch.compare import differences
    from robomend_batch.results import Results, moment, short_times, told

    def words(verdict: tuple[str, tuple[tuple[str, ...], ...]] | None) -> str:
        if verdict is None:
            return "nothing"
        if verdict[0] == "degraded":
            return f"{told(verdict[1])} (degraded)"
        return told(verdict[1]) if verdict[0] == "faulty" else verdict[0]

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
            click.echo(f"{found.log}  {span}: {words(found.before)} -> {words(found.after)}")
    said = (
        f"{counted(count, 'difference')} in {counted(len(logs), 'log')}, {short_times(span_ns)}"
        if count
        else "no difference"
    )
    click.echo(said, err=True)
    return 1 if count and fail_on_difference else 0


@click.command("compare")
@click.argument("out", type=OUT)
@click.option(
    "--format", "format_", type=click.Choice(("table", "ndjson")), default="table", show_default=True
)
def compare(out: Path, format_: str) -> int:
    """Group the logs in OUT by what they show: which have the same faults?"""
    from robomend_batch.compare import groups
    from robomend_batch.results import Results, told

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
