"""Observations as they come in over HTTP: one JSON batch, or a stream of them.

The body is read within its limits, checked, and is a Batch then: sentences that nobody has read yet. Its
route (routers/observations.py, or the short way here) hands it to Robots.observe.

A stream, NDJSON, is read as it comes in constant memory. A line is a batch as in JSON. Consecutive lines
are kept together, as one revision, up to GROUP sentences at a time, so that a robot which comes back after
an hour offline is taken in at disk speed.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import AsyncIterator
from json.encoder import encode_basestring_ascii
from typing import Any

from pydantic import ValidationError
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute
from starlette.types import Receive, Scope, Send

from robomend.api.body import BYTES_PER_S, check_content_type, loads, loads_in_turn, read_chunks
from robomend.api.deps import Parts
from robomend.api.gate import Admission, by_name, reporter_of
from robomend.api.lists import NDJSON
from robomend.api.problems import Problem, answer_to, of_body, of_error
from robomend.api.schemas.base import NAME
from robomend.api.schemas.observations import OBSERVATIONS, ObservationsBody
from robomend.errors import ObservationError, RobomendError
from robomend.robots.batches import Acknowledged, Batch
from robomend.security import API, Principal
from robomend.store.records import IdempotencyKey
from robomend.yielding import Turns

_SCHEMA = OBSERVATIONS.json_schema(ref_template="#/components/schemas/{model}")
COMPONENTS: dict[str, Any] = _SCHEMA.pop("$defs")
"""What the schema of a batch refers to."""

OPENAPI_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": _SCHEMA},
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
    chunks = read_chunks(request, settings.max_body_bytes, settings.body_timeout_s, BYTES_PER_S)
    body = b"".join([chunk async for chunk in chunks])
    check_content_type(request, "application/json", NDJSON)
    batch = batch_of(await loads_in_turn(body, settings.max_nesting, parts.robots.readers))
    once = None if key is None else once_of(request.scope, principal, key, hashlib.sha256(body).hexdigest())
    return batch, once


def batch_of(value: Any) -> Batch:
    """Return the batch that a JSON value is. Problem (422): it is none, field by field."""
    try:
        batch: Batch = OBSERVATIONS.validator.validate_python(value)
    except ValidationError as error:
        raise of_body(error, ObservationsBody) from error
    return batch


def accepted_response(outcome: Acknowledged) -> Response:
    """Return what became of a batch; written directly, since this is the busiest answer of all."""
    changed = ", ".join(map(encode_basestring_ascii, outcome.changed))
    rest = json.dumps([_refused(fault) for fault in outcome.refused]) if outcome.refused else "[]"
    body = f'{{"revision": {outcome.revision}, "changed": [{changed}], "refused": {rest}}}'
    return Response(body, media_type="application/json")


def _refused(fault: ObservationError) -> dict[str, Any]:
    return {"sentence": fault.sentence, "position": fault.position, "message": fault.message}


def once_of(scope: Scope, principal: Principal, key: str, digest: str) -> IdempotencyKey:
    """Return what makes a repeat harmless: one key, one place, and one body, of which this is the digest."""
    path: str = scope["path"]
    return IdempotencyKey(f"{principal.name} {scope['method']} {path.removeprefix(API)}", key, digest)


GROUP = 1000
"""Sentences that are kept at once: large enough for the disk, small enough that others get their turn."""


async def ingest(
    request: Request, parts: Parts, robot: str, principal: Principal, key: str | None
) -> Response:
    """Take in an NDJSON body group by group; the answer says how far it came."""
    request.scope["robomend.waits"] = True
    by = reporter_of(principal)
    revision = (await parts.robots.memory.robot(robot)).revision
    lines = accepted = groups = 0
    group: list[Batch] = []
    raw = hashlib.sha256()
    number = sentences = 0
    unread = False  # line `number`, that is
    turns = Turns()

    async def keep() -> None:
        nonlocal revision, lines, accepted, groups, sentences, raw
        await turns.end()
        once = None if key is None else once_of(request.scope, principal, f"{key}#{groups}", raw.hexdigest())
        outcome = await parts.robots.observe(robot, *group, by=by, once=once)
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
            await turns.rest()
            if line.isspace() or not line:
                continue
            unread = True
            _check_length(line, parts.settings.max_line_bytes)
            batch = batch_of(loads(line, parts.settings.max_nesting))
            unread = False
            group.append(batch)
            sentences += len(batch.observations) + len(batch.assertions)
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


PATH = re.compile(rf"{API}/robots/({NAME.strip('^$')})/observations\Z")
KEY = re.compile(rb"[\x21-\x7e]{1,200}\Z")
RULE = ("POST", f"{API}/robots/{{robot}}/observations")


class Express:
    """A short way for the busiest request of all, POST …/observations with a JSON batch.

        edge ──► plain? ── yes ──► gate ──► read ──► robots ──► answer
                   │ no
                   └─► the framework: routing, exit stacks, dependencies, validation ──► the same functions

    The framework's way costs twice what the rest of this request does. The route stays declared where it was,
    in routers/observations.py, with its schema and its place in the gate's table; this is the same sequence
    of the same functions. Whatever is not quite plain takes the framework's way and gets its answers:
    tests/api/test_bad_input.py holds both to the same answers.
    """

    def __init__(self, parts: Parts, gate: Admission, route: BaseRoute) -> None:
        """`route` is the one that this is a short way to; metrics name it."""
        self._parts = parts
        self._gate = gate
        self._route = route

    def takes(self, scope: Scope) -> bool:
        """Return whether this request is a plain one; then `scope` knows its robot."""
        headers = by_name(scope)
        if scope["method"] != "POST" or headers.get(b"content-type") != b"application/json":
            return False
        found = PATH.match(scope["path"])
        if found is None or not KEY.match(headers.get(b"idempotency-key", b"-")):
            return False
        scope["path_params"] = {"robot": found[1]}
        scope["route"] = self._route
        return True

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that `takes` has found to be plain."""
        request, parts = Request(scope, receive), self._parts
        given = by_name(scope).get(b"idempotency-key")
        try:
            principal = await self._gate.admit(request, RULE)
            batch, once = await read_batch(
                request, parts, principal, None if given is None else given.decode()
            )
            with parts.shedding.one(time.perf_counter() - scope["robomend.began"]):
                outcome = await parts.robots.observe(
                    scope["path_params"]["robot"], batch, by=reporter_of(principal), once=once
                )
            response = accepted_response(outcome)
        except (Problem, RobomendError) as error:
            response = answer_to(request, error)
        await response(scope, receive, send)
