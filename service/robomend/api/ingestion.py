"""Observations as they come in over HTTP: one JSON batch. A stream of them is read in ndjson.py.

The body is read within its limits, checked, and is a Batch then: sentences that nobody has read yet. Its
route (routers/observations.py, or express.py) hands it to Robots.observe.
"""

from __future__ import annotations

import hashlib
from typing import Any

from pydantic import ValidationError
from starlette.requests import Request
from starlette.types import Scope

from robomend.api import strict_json
from robomend.api.body import BYTES_PER_S, check_content_type, read_chunks
from robomend.api.deps import Parts
from robomend.api.problems import of_body
from robomend.api.schemas.observations import OBSERVATIONS, ObservationsBody
from robomend.robots.batches import Batch
from robomend.security import API, Principal
from robomend.store.records import IdempotencyKey

NDJSON = "application/x-ndjson"

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
    batch = batch_of(await strict_json.loads_in_turn(body, settings.max_nesting, parts.robots.readers))
    once = None if key is None else once_of(request.scope, principal, key, hashlib.sha256(body).hexdigest())
    return batch, once


def batch_of(value: Any) -> Batch:
    """Return the batch that a JSON value is. Problem (422): it is none, field by field."""
    try:
        batch: Batch = OBSERVATIONS.validator.validate_python(value)
    except ValidationError as error:
        raise of_body(error, ObservationsBody) from error
    return batch


def once_of(scope: Scope, principal: Principal, key: str, digest: str) -> IdempotencyKey:
    """Return what makes a repeat harmless: one key, one place, and one body, of which this is the digest."""
    path: str = scope["path"]
    return IdempotencyKey(f"{principal.name} {scope['method']} {path.removeprefix(API)}", key, digest)
