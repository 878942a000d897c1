"""The body of PUT /models/{name}: JSON with the text in it, or the text itself, as `curl` sends files."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError
from starlette.requests import Request

from robomend.api import strict_json
from robomend.api.body import BYTES_PER_S, check_content_type, content_type, read_chunks
from robomend.api.problems import Problem, of_body
from robomend.api.schemas.models import ModelBody
from robomend.robots.readers import Readers
from robomend.settings import Settings

TEXTS = ("application/yaml", "text/yaml", "application/x-yaml", "text/x-yaml", "text/plain")

OPENAPI_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": ModelBody.model_json_schema()},
            **{
                kind: {
                    "schema": {"type": "string", "minLength": 1, "description": "the model as it is written"},
                    "example": "robomend: 1\nname: lamp\nhardware:\n  battery: {channel: 1}\nnodes: {}\n",
                }
                for kind in TEXTS
            },
        },
    }
}


async def read_model(request: Request, settings: Settings, readers: Readers) -> ModelBody:
    """Return the model of a body. In JSON its line ends take two bytes, so that may be twice as long."""
    text = content_type(request) in TEXTS
    limit = max(settings.max_body_bytes, settings.max_model_bytes * (1 if text else 2))
    chunks = [chunk async for chunk in read_chunks(request, limit, settings.body_timeout_s, BYTES_PER_S)]
    body = b"".join(chunks)
    check_content_type(request, "application/json", *TEXTS)
    if text:
        value: Any = {"source": _decoded(body)}
    else:
        value = await strict_json.loads_in_turn(body, settings.max_nesting, readers)
    try:
        return ModelBody.model_validate(value)
    except ValidationError as error:
        raise of_body(error, ModelBody) from error


def _decoded(body: bytes) -> str:
    try:
        return body.decode()
    except UnicodeDecodeError as error:
        raise Problem(400, f"the text is not UTF-8: byte {error.start}") from error
