"""Batches: recorded logs, and what they show."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from robomend.api.schemas.base import In, ModelName, Moment, Nanoseconds, Out, Reason, moment_of
from robomend.batches.program import TOGETHER, BatchOptions

Pattern = Annotated[str, Field(min_length=1, max_length=1000, examples=["night/**/*.mcap"])]


class BatchFields(In):
    """What is asked for, besides the logs."""

    model: ModelName | None = Field(default=None, description="a stored model; or `source`")
    source: str | None = Field(
        default=None, min_length=1, max_length=64 << 20, description="a model's text; or `model`"
    )
    observers: str | None = Field(
        default=None,
        min_length=1,
        max_length=4 << 20,
        description="for recorded messages: the text of an agent's file, or of its `observers:`; of "
        "installed kinds only",
    )
    minimal: Literal["cardinality", "subset"] = "subset"
    max_size: int | None = Field(
        default=None, ge=0, le=1_000_000, description="no diagnosis larger than this"
    )
    limit: int = Field(default=100, ge=0, le=1_000_000, description="diagnoses of a state; 0: no limit")
    timeout_s: float = Field(default=5.0, gt=0, le=3600, description="for a state")
    unknown: Literal["refuse", "keep"] = Field(
        default="refuse", description="a log with names that the model does not declare"
    )
    time: Literal["log", "header"] = Field(default="log", description="whose times of messages count")
    together: str | None = Field(
        default=None,
        pattern=f"^({TOGETHER.pattern})$",
        examples=["30s"],
        description="`log`, or a time: one explanation for so long",
    )
    reason: Reason = ""

    def options(self) -> BatchOptions:
        """Return the options of the run."""
        names = BatchOptions.__slots__
        return BatchOptions(**{name: getattr(self, name) for name in names})


class BatchBody(BatchFields):
    """Logs below the setting `batch_folder`."""

    logs: list[Pattern] = Field(
        min_length=1,
        max_length=1000,
        description="files, folders and patterns, relative to the setting `batch_folder`",
    )


class BatchOptionsOut(Out):
    """How the logs are diagnosed."""

    minimal: str
    max_size: int | None
    limit: int
    timeout_s: float
    unknown: str
    time: str
    together: str | None


class BatchOut(Out):
    """A batch: how far it is, and what became of its logs."""

    id: str = Field(examples=["b-7k2m9x4qhj"])
    state: str = Field(examples=["running"], description="waiting, running, done, failed or cancelled")
    model: str = Field(examples=["tedusar@5f0c9a"])
    logs: int = Field(description="files")
    bytes: int = Field(description="of an upload")
    uploaded: bool
    options: BatchOptionsOut
    host: str = Field(description="the computer that has its files, and carries it out")
    by: str
    reason: str
    done: int = Field(description="files that are diagnosed")
    log_states: dict[str, int] = Field(
        description="logs by what became of them: ok, unchecked, ended-early, bad, refused, lost",
        examples=[{"ok": 12}],
    )
    faulty: int = Field(description="logs that show a fault")
    message: str = Field(description="what was wrong, as robomend-batch says it")
    created_ns: Nanoseconds
    created: Moment = moment_of("created_ns")
    updated_ns: Nanoseconds
    updated: Moment = moment_of("updated_ns")
    started_ns: Nanoseconds | None
    started: Moment | None = moment_of("started_ns")
    finished_ns: Nanoseconds | None
    finished: Moment | None = moment_of("finished_ns")
