"""`robomend-batch report`: a folder of results as one HTML file."""

from __future__ import annotations

from pathlib import Path

import click

from robomend.errors import InputError

OUT = click.Path(file_okay=False, path_type=Path)


@click.command("report")
@click.argument("out", type=OUT)
@click.option(
    "--file", "-f", type=click.Path(dir_okay=False, path_type=Path), help="Default: report.html in OUT."
)
@click.option("--title", default="What the logs show", show_default=True)
@click.option(
    "--log",
    "logs",
    multiple=True,
    metavar="NAME",
    help='Only logs of this name or pattern ("monday/*.bag"), again for more; needs --file.',
)
def command(out: Path, file: Path | None, title: str, logs: tuple[str, ...]) -> int:
    """Write what the results in OUT say as one HTML file, which needs no network.

    It has the faults, those of most logs first, with their explanation and their logs; a table of all logs; a
    timeline of each log with a fault, 64 MB of them at most.

    \b
    robomend-batch report out
    robomend-batch report out --log "monday/*.bag" --file monday.html
    """
    from robomend_batch.manifest import write_beside
    from robomend_batch.report import report
    from robomend_batch.results import Results

    if logs and file is None:
        raise click.UsageError("--log needs --file: report.html is the report of all logs")
    results = Results(out)
    if logs:
        results.choose(logs)
    text = report(results, title)
    target = file or out / "report.html"
    try:
        write_beside(target, text.encode("utf-8", "replace"))
    except OSError as error:
        raise InputError(f"{target} cannot be written: {error.strerror}") from error
    click.echo(str(target))
    return 0
