"""`robomend-batch`: the commands by name; each is imported when it is run.

To add a command: its module with a click command, a line in COMMANDS, and its section in docs/batch.md.
"""

from __future__ import annotations

import click

from robomend.cli.commands import LazyGroup, Table

COMMANDS: Table = {
    "run": ("robomend_batch.run_command:command", "Diagnose logs into a folder of results."),
    "learn": ("robomend_batch.learn_command:command", "Draft a model and observers from healthy logs."),
    "report": ("robomend_batch.report_command:command", "Write results as one HTML file."),
    "compare": ("robomend_batch.compare:compare", "Group the logs by what they show."),
    "diff": ("robomend_batch.compare:diff", "Say where two folders of results differ."),
    "priors": ("robomend_batch.priors:command", "Estimate a model's priors from confirmed faults."),
    "query": ("robomend_batch.query_command:command", "Answer SQL over results."),
}


@click.group(
    "robomend-batch",
    cls=LazyGroup,
    table=COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="robomend", prog_name="robomend-batch", message="%(prog)s %(version)s")
def batch() -> None:
    """Which of these logs shows which fault, when, and is it the same one?"""
