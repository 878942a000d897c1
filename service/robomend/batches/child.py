"""What runs before robomend-batch in its process: `python -P -m robomend.batches.child PARENT BYTES NICE …`.

It ends with the service, gives way to it (nice, and first to be killed for lack of memory), writes no file
larger than it may, and then becomes the program. `-P`: no module is taken from the folder of the logs.
"""

from __future__ import annotations

import contextlib
import os
import resource
import sys
from pathlib import Path

from robomend.workers.parent import die_with_parent

FIRST_TO_GO = "500"


def main() -> None:
    """Become the program."""
    parent, most_bytes, nice, *arguments = sys.argv[1:]
    die_with_parent()
    if os.getppid() != int(parent):  # it died before we said so
        sys.exit(1)
    os.nice(int(nice))
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_GO)
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    wanted = int(most_bytes)
    most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))
    os.execv(sys.executable, [sys.executable, "-P", "-m", "robomend_batch", *arguments])


if __name__ == "__main__":
    main()
