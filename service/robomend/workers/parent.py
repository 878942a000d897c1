"""A process that must not outlive the one that started it."""

from __future__ import annotations

import contextlib
import ctypes
import signal

PR_SET_PDEATHSIG = 1  # from <linux/prctl.h>


def die_with_parent() -> None:
    """Have the kernel kill this process when its parent ends: in native code and when stopped, too.

    Strictly it is when the *thread* ends that started us. Where there is no such call, or the parent is gone
    already, nothing happens: who calls this watches a pipe from the parent as well, or looks who it is.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
