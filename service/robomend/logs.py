"""Logs as JSON lines (or text) on stderr, with the ids of request and robot.
Secrets are cut out before writing.

Everything that is not ours (uvicorn, the board link) logs through the standard library and comes out the
same way.

Of entries of one kind only so many are written in a second: in an overload, or under somebody who tries
keys, there would be a line for each request that is refused, and to write one lets go of the interpreter's
lock and queues for it again. The next one that is written tells how many were left out; /metrics counts all
requests by status.
"""

from __future__ import annotations

import logging
import re
import sys
import threading
import time
from collections.abc import MutableMapping
from contextlib import suppress
from contextvars import ContextVar
from typing import Any, TextIO, cast

import structlog

KEY_TEXT = re.compile(r"rm_[A-Za-z0-9_-]{43}")
PASSWORD = re.compile(r"(://[^:/@\s]+:)[^@\s]+(@)")

MOST_A_SECOND = 10
"""Entries of one kind; those of level debug, which was asked for, are all written."""

KINDS = 1000
"""Counted at a time."""

Entry = MutableMapping[str, Any]

REQUEST: ContextVar[str | None] = ContextVar("request", default=None)
"""The id of the request that is answered here; in every entry."""

PRINCIPAL: ContextVar[str | None] = ContextVar("principal", default=None)
"""Whose request it is."""

_least = logging.DEBUG
"""The level from which on entries are written."""


def debugging() -> bool:
    """Return whether debug entries are written: making one that is dropped costs a request 0.01 ms."""
    return _least <= logging.DEBUG


class Crowds(logging.Filter):
    """Drops what is too many in a second: entries of one event, status, code, principal; or text."""

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._second = 0
        self._written: dict[tuple[Any, ...], int] = {}  # in this second
        self._left_out: dict[tuple[Any, ...], int] = {}  # not yet told

    def __call__(self, _: Any, method: str, entry: Entry) -> Entry:
        """Return an entry that is to be written."""
        if method == "debug":
            return entry
        kind = (entry.get("event"), entry.get("status"), entry.get("code"), entry.get("principal"))
        left_out = self._left_out_of(kind)
        if left_out is None:
            raise structlog.DropEvent
        if left_out:
            entry["left_out"] = left_out
        return entry

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record of the standard library is to be written: the server's own are of any request."""
        if record.levelno <= logging.DEBUG:
            return True
        left_out = self._left_out_of((record.name, record.msg))
        if left_out:
            record.msg, record.args = f"{record.getMessage()} ({left_out} more were left out)", ()
        return left_out is not None

    def _left_out_of(self, kind: tuple[Any, ...]) -> int | None:
        """Return how many of a kind were left out before the one that comes now; None: it is, too."""
        with self._lock:
            second = int(time.monotonic())
            if second != self._second:
                self._second = second
                self._written.clear()
            written = self._written[kind] = self._written.get(kind, 0) + 1
            if written <= MOST_A_SECOND:
                return self._left_out.pop(kind, 0)
            if len(self._left_out) > KINDS:
                self._left_out.clear()
            self._left_out[kind] = self._left_out.get(kind, 0) + 1
            return None


def of_request(_: Any, __: str, entry: Entry) -> Entry:
    """Name the request that an entry is about; structlog's own way binds what nearly no request logs."""
    for name, value in (("request", REQUEST.get()), ("principal", PRINCIPAL.get())):
        if value is not None:
            entry.setdefault(name, value)
    return entry


def without_secrets(_: Any, __: str, entry: Entry) -> Entry:
    """Mask keys and passwords of URLs, wherever they got into an entry."""
    for name, value in entry.items():
        if isinstance(value, str):
            entry[name] = PASSWORD.sub(r"\1***\2", KEY_TEXT.sub("rm_***", value))
    return entry


class Stderr:
    """Standard error, of which nobody is told that it cannot be written: who reads it is gone, the disk full.

    Whoever logs goes on.
    """

    def __init__(self) -> None:
        self._stream = sys.stderr

    def write(self, text: str) -> int:
        """Write what can be written."""
        with suppress(OSError, ValueError):  # ValueError: it is closed
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Hand it on, if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.flush()


def configure(level: str, form: str) -> None:
    """Set up logging for the process; `form` is "json" or "text"."""
    global _least  # of the process, as all of the logging is
    stderr = Stderr()
    _least = number = logging.getLevelNamesMapping()[level.upper()]
    shared: list[Any] = [
        of_request,
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.format_exc_info,
        without_secrets,
    ]
    renderer: Any = (
        structlog.processors.JSONRenderer()
        if form == "json"
        else structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty())
    )
    structlog.configure(
        processors=[Crowds(), *shared, renderer],
        wrapper_class=structlog.make_filtering_bound_logger(number),
        logger_factory=structlog.PrintLoggerFactory(cast(TextIO, stderr)),
        cache_logger_on_first_use=False,  # tests and commands configure more than once
    )
    handler = logging.StreamHandler(stderr)
    handler.addFilter(Crowds())
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[structlog.stdlib.add_logger_name, *shared],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
        )
    )
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(max(number, logging.WARNING))
