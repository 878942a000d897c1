"""The entry point of `robomend-batch`."""

from __future__ import annotations

import sys

from robomend.cli.main import interruptible


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""

    def program() -> int:
        from robomend.cli.commands import run
        from robomend_batch.commands import batch
        from robomend_batch.garbage import collect_less

        collect_less()
        return run(sys.argv[1:] if arguments is None else arguments, batch)

    sys.exit(interruptible(program))
