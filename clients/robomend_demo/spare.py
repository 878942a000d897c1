"""Let the drivers of a device find another one in its place, when they start the next time.

    python -m robomend_demo.spare NODES_FILE DEVICE SPARE

It is the action `switch_to_spare` of the robot's agent; on a real robot it might move a link in /dev.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path


def switch(nodes_file: Path, device: str, spare: str) -> None:
    """Give a device's name the address of its spare, in the file that nodes.py reads.

    KeyError: there is no such device.
    """
    config = json.loads(nodes_file.read_text(encoding="utf-8"))
    config["devices"][device] = config["devices"][spare]
    fresh = nodes_file.with_suffix(".new")  # a driver that starts meanwhile reads the old file or the new one
    fresh.write_text(json.dumps(config, indent=2), encoding="utf-8")
    os.replace(fresh, nodes_file)


def main() -> int:
    if len(sys.argv) != 4:
        print("usage: python -m robomend_demo.spare NODES_FILE DEVICE SPARE", file=sys.stderr)
        return 2
    switch(Path(sys.argv[1]), sys.argv[2], sys.argv[3])
    return 0


if __name__ == "__main__":
    sys.exit(main())
