"""POST /batches, for programs and for the page: a body → logs in a folder → a batch that waits.

The body of POST /batches: JSON that names logs of this computer, or a form (`multipart/form-data`)
with the logs themselves.

A form goes to the disk as it comes, in constant memory: parts named `logs` are files, all other parts are the
fields of the JSON. One that is cut off, too large or malformed leaves nothing behind.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError
from starlette.requests import Request

from robomend.api.body import BYTES_PER_S, check_content_type, content_type, loads_in_turn, read_chunks
from robomend.api.deps import Parts
from robomend.api.problems import Problem, of_body
from robomend.api.schemas.base import In, ModelName, Moment, Nanoseconds, Out, Reason, moment_of
from robomend.batches.batches import NewBatch
from robomend.batches.log_names import check_upload
from robomend.batches.program import TOGETHER, BatchOptions
from robomend.errors import InputError
from robomend.robots.readers import Readers
from robomend.security import Principal
from robomend.settings import Settings
from robomend.store.records import Json

# --- what is asked for and answered


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


# --- how it comes

FORM = "multipart/form-data"

AT_ONCE = 1 << 20
"""Bytes that are handed to the disk together."""

MOST_FIELDS = 30

NUMBERS = {"max_size": int, "limit": int, "timeout_s": float}

OPENAPI_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": BatchBody.model_json_schema()},
            FORM: {
                "schema": {
                    "type": "object",
                    "required": ["logs"],
                    "properties": {
                        **{
                            name: {"type": "string", "description": f"as in JSON: `{name}`"}
                            for name in BatchBody.model_fields
                            if name != "logs"
                        },
                        "logs": {"type": "array", "items": {"type": "string", "format": "binary"}},
                    },
                }
            },
        },
    }
}

Fields = TypeVar("Fields", bound=In)


async def read_json(request: Request, settings: Settings, readers: Readers) -> BatchBody:
    """Return what a JSON body asks for."""
    limit = max(settings.max_body_bytes, 2 * settings.max_model_bytes)
    chunks = [chunk async for chunk in read_chunks(request, limit, settings.body_timeout_s, BYTES_PER_S)]
    value = await loads_in_turn(b"".join(chunks), settings.max_nesting, readers)
    return validated(BatchBody, value)


def validated(kind: type[Fields], value: Any) -> Fields:
    """Return the fields of a body; a Problem names what is at fault."""
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        raise of_body(error, kind) from error


def typed(texts: Mapping[str, str]) -> dict[str, Any]:
    """Return the fields of a form as their JSON has them; what is empty is not said."""
    found: dict[str, Any] = {}
    for name, text in texts.items():
        if text != "":
            try:
                found[name] = NUMBERS.get(name, str)(text)
            except ValueError:
                raise InputError(f"{name}: {text[:40]!r} is no number") from None
    return found


@dataclass
class Form:
    """A form as it comes: fields in memory, logs on the disk. `feed` waits for the disk."""

    boundary: bytes
    folder: Path
    most_logs: int
    most_text: int
    texts: dict[str, str] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    size: int = 0  # of the logs
    ended: bool = False
    _headers: dict[str, str] = field(default_factory=dict)
    _header: bytearray = field(default_factory=bytearray)
    _value: bytearray = field(default_factory=bytearray)
    _field: str | None = None
    _text: bytearray = field(default_factory=bytearray)
    _texts_size: int = 0
    _file: IO[bytes] | None = None

    def __post_init__(self) -> None:
        from python_multipart.multipart import MultipartParser  # of the extra `batch`

        self._parser = MultipartParser(
            self.boundary,
            {
                "on_part_begin": self._begin,
                "on_header_field": lambda data, start, end: self._header.extend(data[start:end]),
                "on_header_value": lambda data, start, end: self._value.extend(data[start:end]),
                "on_header_end": self._header_ended,
                "on_headers_finished": self._part,
                "on_part_data": self._data,
                "on_part_end": self._part_ended,
                "on_end": self._ended,
            },
        )

    def feed(self, data: bytes) -> None:
        """Take in what came; Problem, Refused or InputError for what is wrong with it."""
        from python_multipart.exceptions import FormParserError

        try:
            self._parser.write(data)
        except FormParserError as error:
            raise Problem(400, f"the form is malformed: {error}") from error

    def finish(self) -> None:
        """Say that nothing more comes."""
        if not self.ended:
            raise Problem(400, "the form has no end")

    def close(self) -> None:
        """Close what is open."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _begin(self) -> None:
        self._headers = {}
        self._field = None

    def _header_ended(self) -> None:
        self._headers[self._header.decode("latin-1").lower()] = self._value.decode("latin-1")
        self._header.clear()
        self._value.clear()

    def _part(self) -> None:
        from python_multipart.multipart import parse_options_header

        _, options = parse_options_header(self._headers.get("content-disposition"))
        name = options.get(b"name", b"").decode("utf-8", "replace")
        file = options.get(b"filename")
        if name == "logs":
            if file is None:
                raise InputError("logs: in a form they are files, not names; send JSON to name files here")
            if file == b"":  # a browser's field in which no file was chosen
                return
            self._log(file.decode("utf-8", "replace"))
        else:
            if name in self.texts:
                raise InputError(f"{name[:80]!r} stands twice in the form")
            if len(self.texts) >= MOST_FIELDS:
                raise InputError(f"the form has more than {MOST_FIELDS} fields")
            self._field = name
            self.texts[name] = ""

    def _log(self, name: str) -> None:
        check_upload(name)
        if name in self.names:
            raise InputError(f"{name}: two logs have this name")
        if len(self.names) >= self.most_logs:
            raise InputError(f"more than {self.most_logs} logs (max_batch_logs); send fewer at once")
        self.names.append(name)
        self._file = (self.folder / name).open("xb")

    def _data(self, data: bytes, start: int, end: int) -> None:
        if self._file is not None:
            self._file.write(data[start:end])
            self.size += end - start
        elif self._field is not None:
            self._text.extend(data[start:end])
            self._texts_size += end - start
            if self._texts_size > self.most_text:
                raise Problem(413, f"the fields beside the logs have more than {self.most_text} bytes")

    def _part_ended(self) -> None:
        self.close()
        if self._field is not None:
            try:
                self.texts[self._field] = self._text.decode()
            except UnicodeDecodeError as error:
                raise InputError(f"{self._field[:80]!r} is not UTF-8: byte {error.start}") from error
            self._text.clear()

    def _ended(self) -> None:
        self.ended = True


async def read_form(request: Request, settings: Settings, folder: Path) -> Form:
    """Read a form to its end, its logs into a folder.

    Raises:
        Problem: 413 when it is too large, 408 when it stalls, 400 when it is malformed.
        Refused, InputError: of a log's name or a field.
        OSError: the disk is full.
        ClientDisconnect: the client went away in the middle.
    """
    form = Form(_boundary(request), folder, settings.max_batch_logs, settings.max_model_bytes)
    waiting = bytearray()
    limit, timeout_s = settings.max_batch_bytes, settings.body_timeout_s
    try:
        async for chunk in read_chunks(request, limit, timeout_s, BYTES_PER_S):
            waiting += chunk
            if len(waiting) >= AT_ONCE:
                await asyncio.to_thread(form.feed, bytes(waiting))
                waiting.clear()
        await asyncio.to_thread(form.feed, bytes(waiting))
        form.finish()
    finally:
        form.close()
    return form


def _boundary(request: Request) -> bytes:
    from python_multipart.multipart import parse_options_header

    _, options = parse_options_header(request.headers.get("content-type"))
    boundary = options.get(b"boundary", b"")
    if not 1 <= len(boundary) <= 70:
        raise Problem(400, "multipart/form-data names its boundary in Content-Type, of 1 to 70 characters")
    return boundary


PATHS = "paths"
"""A field of the page's form: names below batch_folder, one a line, where no file is chosen."""


async def create(request: Request, parts: Parts, principal: Principal, *, page: bool = False) -> Json:
    """Keep a batch, and return it.

    Args:
        request: with a JSON body or a form.
        parts: of the service.
        principal: who asks.
        page: whether the form may name logs of this computer in PATHS.
    """
    parts.batches.check_installed()
    request.scope["robomend.waits"] = True
    check_content_type(request, FORM, *(() if page else ("application/json",)))
    if content_type(request) != FORM:
        body = await read_json(request, parts.settings, parts.robots.readers)
        async with parts.batches.new() as new:
            return await _keep_named(parts, new, body, principal)
    async with parts.batches.new() as new:
        form = await read_form(request, parts.settings, new.folder.logs)
        paths = form.texts.pop(PATHS, "").split("\n") if page else []
        logs = [line.strip() for line in paths if line.strip()]
        if logs and form.names:
            raise InputError("give either files or paths, not both")
        if logs:
            return await _keep_named(
                parts, new, validated(BatchBody, {**typed(form.texts), "logs": logs}), principal
            )
        if not form.names:
            raise InputError("logs: the form has no file")
        fields = validated(BatchFields, typed(form.texts))
        return await _keep(parts, new, fields, principal, names=sorted(form.names), size=form.size)


async def _keep_named(parts: Parts, new: NewBatch, body: BatchBody, principal: Principal) -> Json:
    folder, names = await parts.batches.below_folder(body.logs)
    return await _keep(parts, new, body, principal, names=names, folder=folder, size=0)


async def _keep(
    parts: Parts, new: NewBatch, fields: BatchFields, principal: Principal, *, folder: Any = None, **logs: Any
) -> Json:
    subject = await parts.robots.models.subject(fields.model, fields.source)
    name = subject.version if fields.model is not None else f"{subject.system.name} (as sent)"
    return await parts.batches.keep(
        new,
        model=name,
        source=subject.system.source,
        observers=fields.observers,
        folder=folder,
        options=fields.options(),
        by=principal.name,
        reason=fields.reason,
        **logs,
    )
