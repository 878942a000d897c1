"""What is loaded when the service starts is never looked at by the garbage collector."""

from __future__ import annotations

import subprocess
import sys


def test_what_is_loaded_at_the_start_is_never_looked_at_again() -> None:
    program = (
        "import gc; gc.disable()\n"
        "from robomend.cli import serve\n"
        "loaded = len(gc.get_objects())\n"
        "serve.settle()\n"
        "print(gc.isenabled(), gc.get_freeze_count() > loaded / 2, len(gc.get_objects()) < loaded / 20)\n"
        "print(gc.get_threshold() == serve.GARBAGE)"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert ran.stdout.split() == ["True"] * 4, ran.stderr
