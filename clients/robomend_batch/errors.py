"""What a run ends with."""

from __future__ import annotations

import errno

from robomend.errors import BackendError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class SchedulerFailed(BackendError):
    """A Dask cluster cannot do the work."""

    code = "scheduler-failed"


class DiskFull(BackendError):
    """Results cannot be written."""

    code = "disk-full"

    def __str__(self) -> str:
        return f"{super().__str__()}; make room, and the same command goes on"
