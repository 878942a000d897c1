"""Observations as they come in: one JSON batch, or NDJSON, read as it streams in constant memory.

A line of NDJSON is a batch as in JSON. Consecutive lines of one source and lifetime are kept together, as
one revision, up to GROUP literals at a time, so that a robot which comes back after an hour offline is
taken in at disk speed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import AsyncIterator
from typing import Any

from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from starlette.requests import Request
from starlette.responses import Response

from robomend.api import strict_json
from robomend.api.body import check_content_type, read_chunks
from robomend.api.deps import Parts
from robomend.api.problems import Problem, of_error, of_validation
from robomend.api.schemas.base import MAX_INT
from robomend.api.schemas.observations import ObservationsBody
from robomend.errors import RobomendError
from robomend.robots.batches import Batch
from robomend.security import API, Principal
from robomend.store.records import IdempotencyKey

NDJSON = "application/x-ndjson"

GROUP = 1000
"""Sentences that are kept at once: large enough for the disk, small enough that others get their turn."""

PLAIN = frozenset({"observations", "time"})
"""The fields of nearly every batch."""

OPENAPI_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": ObservationsBody.model_json_schema()},
            NDJSON: {
                "schema": {"type": "string", "description": "a batch, as in JSON, in each line"},
                "example": '{"observations": ["not ok(scan)"], "time": 1764000000000000000}\n'
                '{"observations": ["ok(scan)"], "time": 1764000001000000000}\n',
            },
        },
    }
}


async def read_batch(
    request: Request, parts: Parts, principal: Principal, key: str | None
) -> tuple[Batch, IdempotencyKey | None]:
    """Return the batch of a JSON body, and what makes a repeat of it harmless."""
    settings = parts.settings
    body = b"".join(
        [chunk async for chunk in read_chunks(request, settings.max_body_bytes, settings.body_timeout_s)]
    )
    check_content_type(request, "application/json", NDJSON)
    batch = _batch(strict_json.loads(body, settings.max_nesting))
    return batch, _once(request, principal, key, body)


async def ingest(
    request: Request, parts: Parts, robot: str, principal: Principal, key: str | None
) -> Response:
    """Take in an NDJSON body group by group; the answer says how far it came."""
    request.scope["robomend.waits"] = True
    state = await parts.robots.robot(robot)
    revision = state.revision
    lines = accepted = groups = 0
    group: list[Batch] = []
    raw = hashlib.sha256()
    number = sentences = 0
    unread = False  # line `number`, that is

    async def keep() -> None:
        nonlocal revision, lines, accepted, groups, sentences, raw
        once = None
        if key is not None:
            once = _once(request, principal, f"{key}#{groups}", raw.digest())
        outcome = await parts.robots.observe_all(robot, tuple(group), once=once)
        revision = outcome.revision
        accepted += sentences
        lines = number
        groups += 1
        group.clear()
        sentences = 0
        raw = hashlib.sha256()

    try:
        async for line in _lines(request, parts):
            number += 1
            if line.isspace() or not line:
                continue
            unread = True
            _check_length(line, parts.settings.max_line_bytes)
            batch = _batch(strict_json.loads(line, parts.settings.max_nesting))
            unread = False
            size = len(batch.observations) + len(batch.assertions)
            group.append(batch)
            sentences += size
            raw.update(line)
            if sentences >= GROUP:
                await keep()
        if group:
            await keep()
    except (Problem, RobomendError) as error:
        problem = error if isinstance(error, Problem) else of_error(error)
        problem.extra.update(lines=lines, accepted=accepted, revision=revision)
        apart = number > lines + 1 and not unread
        where = f"between lines {lines + 1} and {number}" if apart else f"line {max(number, lines + 1)}"
        problem.detail = f"{where}: {problem.detail}; the first {lines} lines were kept"
        raise problem from error
    return Response(
        json.dumps({"revision": revision, "lines": number, "accepted": accepted}),
        media_type="application/json",
    )


async def _lines(request: Request, parts: Parts) -> AsyncIterator[bytes]:
    """Yield the lines of a body as they come, never holding more than one and a chunk."""
    settings = parts.settings
    rest = b""
    async for chunk in read_chunks(request, settings.max_stream_bytes, settings.body_timeout_s):
        *complete, rest = (rest + chunk).split(b"\n")
        for line in complete:
            yield line
        _check_length(rest, settings.max_line_bytes)
    if rest:
        yield rest


def _check_length(line: bytes, most: int) -> None:
    if len(line) > most:
        raise Problem(413, f"a line has more than {most} bytes")


def _batch(value: Any) -> Batch:
    """Return the batch of a JSON value; what most of them are takes the short way around the validator."""
    if type(value) is dict and value.keys() <= PLAIN:
        sentences, time_ns = value.get("observations"), value.get("time")
        timed = time_ns is None or (type(time_ns) is int and 0 <= time_ns <= MAX_INT)
        if (
            timed
            and type(sentences) is list
            and 0 < len(sentences) <= 100
            and all(type(sentence) is str and 0 < len(sentence) <= 200 for sentence in sentences)
        ):
            return Batch(tuple(sentences), time_ns=time_ns)
    try:
        body = ObservationsBody.model_validate(value)
    except ValidationError as error:
        faults = [{**fault, "loc": ("body", *fault["loc"])} for fault in error.errors(include_url=False)]
        raise of_validation(RequestValidationError(faults)) from error
    return Batch(
        observations=tuple(body.observations),
        assertions=body.assertions,
        time_ns=body.time,
        source=body.source,
        lifetime_s=body.lifetime_s,
        together=body.together,
    )


def _once(request: Request, principal: Principal, key: str | None, body: bytes) -> IdempotencyKey | None:
    if key is None:
        return None
    scope = f"{principal.name} {request.method} {request.url.path.removeprefix(API)}"
    return IdempotencyKey(scope, key, hashlib.sha256(body).hexdigest())
