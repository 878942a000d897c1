"""Commands of ours that a shell finds on its PATH, and that begin at once: forked as in tests/forked.py.

What the shell starts is a small program that has the template fork the command with its own streams, hands on
the signals that ask for an end, and ends as the command does. It cannot hand on SIGKILL: what is killed so is
started as readers start it, and so is what loads other code than the template did.
"""

from __future__ import annotations

import os
import shlex
import signal
import sys
from pathlib import Path
from typing import NoReturn

from tests import forked

PROGRAMS = {"robomend": "robomend.cli.main", "robomend-agent": "robomend_client.agent.main"}
"""Command -> the module with its `main`."""

SCRIPT = """#!/bin/sh
[ "${{PYTHONPATH-}}|${{LD_PRELOAD-}}" = {loaded} ] || exec {bin}/{name} "$@"
exec {python} -IS -c 'import sys; sys.path.insert(0, "{root}")
from tests.forked_programs import run
run({template}, "{module}")' "$@"
"""


def write(folder: Path) -> Path:
    """Write the commands into a folder that is made for them; return it."""
    folder.mkdir()
    template = forked.template()
    loaded = shlex.quote("|".join(os.environ.get(name, "") for name in ("PYTHONPATH", "LD_PRELOAD")))
    for name, module in PROGRAMS.items():
        file = folder / name
        file.write_text(
            SCRIPT.format(
                python=sys.executable,
                bin=Path(sys.executable).parent,
                root=forked.ROOT,
                name=name,
                module=module,
                template=template,
                loaded=loaded,
            )
        )
        file.chmod(0o755)
    return folder


def run(template: int, module: str) -> NoReturn:
    """Be the command, in the small program."""
    forked.use(template)
    code = f"import sys; from {module} import main; sys.exit(main())"
    process = forked.popen([sys.executable, "-c", code, *sys.argv[1:]])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: process.send_signal(number))
    ended = process.wait()
    if ended < 0:
        signal.signal(-ended, signal.SIG_DFL)
        os.kill(os.getpid(), -ended)
    sys.exit(ended)
