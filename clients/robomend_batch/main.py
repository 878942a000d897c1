"""The entry point of `robomend-batch`."""

from __future__ import annotations

import sys

INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    try:
        from robomend.cli.commands import run
        from robomend_batch.commands import batch
        from robomend_batch.garbage import collect_less

        collect_less()
        code = run(sys.argv[1:] if arguments is None else arguments, batch)
    except KeyboardInterrupt:  # while the rest was being imported; `run` has the others
        code = INTERRUPTED
    sys.exit(code)
