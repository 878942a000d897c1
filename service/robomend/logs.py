"""Logs as JSON lines (or text) on stderr, with the ids of request and robot.
Secrets are cut out before writing.

Everything that is not ours (uvicorn, the board link) logs through the standard library and comes out the
same way.
"""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import MutableMapping
from typing import Any

import structlog

KEY_TEXT = re.compile(r"rm_[A-Za-z0-9_-]{43}")
PASSWORD = re.compile(r"(://[^:/@\s]+:)[^@\s]+(@)")

Entry = MutableMapping[str, Any]

_least = logging.DEBUG
"""The level from which on entries are written."""


def debugging() -> bool:
    """Return whether debug entries are written: making one that is dropped costs a request 0.01 ms."""
    return _least <= logging.DEBUG


def without_secrets(_: Any, __: str, entry: Entry) -> Entry:
    """Mask keys and passwords of URLs, wherever they got into an entry."""
    for name, value in entry.items():
        if isinstance(value, str):
            entry[name] = PASSWORD.sub(r"\1***\2", KEY_TEXT.sub("rm_***", value))
    return entry


def configure(level: str, form: str) -> None:
    """Set up logging for the process; `form` is "json" or "text"."""
    global _least  # of the process, as all of the logging is
    _least = number = logging.getLevelNamesMapping()[level.upper()]
    shared: list[Any] = [
        structlog.contextvars.merge_contextvars,
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
        processors=[*shared, renderer],
        wrapper_class=structlog.make_filtering_bound_logger(number),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=False,  # tests and commands configure more than once
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[structlog.stdlib.add_logger_name, *shared],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
        )
    )
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(max(number, logging.WARNING))
