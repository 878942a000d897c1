"""`robomend-batch query`: SQL over a folder of results."""

from __future__ import annotations

from pathlib import Path

import click

from robomend.errors import InputError
from robomend_batch.report_command import OUT
from robomend_client.counts import counted

FORMATS = ("table", "ndjson", "csv")


@click.command("query")
@click.argument("out", type=OUT)
@click.argument("sql")
@click.option("--format", "format_", type=click.Choice(FORMATS), default="table", show_default=True)
@click.option(
    "--rows", type=click.IntRange(min=1), default=50, show_default=True, help="Of a table, at most."
)
def command(out: Path, sql: str, format_: str, rows: int) -> int:
    """Answer SQL over the results in OUT.

    The tables are `results` (the intervals) and `logs`. For example:

    robomend-batch query OUT "SELECT log, count(*) AS faults FROM results WHERE state = 'faulty' GROUP BY log"
    """
    import polars as pl

    from robomend_batch.results import Results

    results = Results(out)
    keys = ("log", "file", "kind", "state", "start_ns", "end_ns", "segments")
    logs = pl.DataFrame(
        [{key: record[key] for key in keys} for record in results.records],
        schema_overrides={"start_ns": pl.Int64, "end_ns": pl.Int64},
        infer_schema_length=None,
    )
    try:
        with pl.SQLContext(results=results.scan(), logs=logs.lazy()) as context:
            found = context.execute(sql, eager=True)
    except (pl.exceptions.PolarsError, OSError) as error:
        raise InputError(f"the query cannot be answered: {str(error).splitlines()[0]}") from error
    if format_ == "ndjson":
        click.echo(found.write_ndjson(), nl=False)
    elif format_ == "csv":
        try:
            click.echo(found.write_csv(), nl=False)
        except pl.exceptions.PolarsError as error:
            raise InputError("CSV has no lists: select other columns, or --format ndjson") from error
    else:
        wide = {"tbl_rows": rows, "tbl_cols": -1, "tbl_width_chars": 200, "fmt_str_lengths": 80}
        hidden = {"tbl_hide_dataframe_shape": True, "tbl_hide_column_data_types": True}
        with pl.Config(**wide, **hidden):  # type: ignore[arg-type]  # its own names
            click.echo(str(found))
        if len(found) > rows:
            click.echo(
                f"note: {counted(len(found) - rows, 'more row')}; --rows, or --format ndjson", err=True
            )
    return 0
