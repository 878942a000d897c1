"""The entry point of `robomend`, and all that is imported before Ctrl-C is looked after: see commands.py."""

from __future__ import annotations

import sys

INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    try:
        from robomend.cli.commands import run

        code = run(sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt:  # while the rest was being imported; `run` has the others
        code = INTERRUPTED
    sys.exit(code)
