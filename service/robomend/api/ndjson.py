"""A stream of observations, NDJSON, read as it comes in constant memory.

A line is a batch as in JSON. Consecutive lines are kept together, as one revision, up to GROUP sentences at a
time, so that a robot which comes back after an hour offline is taken in at disk speed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import AsyncIterator

from starlette.requests import Request
from starlette.responses import Response

from robomend.api import strict_json
from robomend.api.body import read_chunks
from robomend.api.deps import Parts, reporter_of
from robomend.api.ingestion import batch_of, once_of
from robomend.api.problems import Problem, of_error
from robomend.errors import RobomendError
from robomend.robots.batches import Batch
from robomend.security import Principal
from robomend.turns import Turns

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
            batch = batch_of(strict_json.loads(line, parts.settings.max_nesting))
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
