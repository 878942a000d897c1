"""What all lists have: a `Link` to their next page, and NDJSON, an item a line, for who asks with `Accept`.

A list is a route whose answer is `Items`. The lines of NDJSON are cut from the JSON that the route gave, so
both say the same to the letter; the cursor, which has no place among the lines, is in the link alone.
"""

from __future__ import annotations

import json
import re
from typing import Any

from starlette.datastructures import URL
from starlette.requests import Request
from starlette.responses import Response

from robomend.api.schemas.base import Items
from robomend.yielding import Turns

NDJSON = "application/x-ndjson"

_WEIGHT = re.compile(r"(?:0(?:\.\d{0,3})?|1(?:\.0{0,3})?)\Z")


def quality(accept: str, media_type: str) -> float:
    """Return how much the header wants a media type, 0 to 1; the most specific range that fits counts.

    A header that is empty or missing takes everything. A range that is malformed counts for nothing.
    """
    if not accept.strip():
        return 1.0
    kind = media_type.partition("/")[0]
    fits = {"*/*": 0, f"{kind}/*": 1, media_type: 2}
    best = (-1, 0.0)
    for one in accept.split(","):
        name, *parameters = (part.strip().lower() for part in one.split(";"))
        if name not in fits:
            continue
        weights = [value for key, _, value in (p.partition("=") for p in parameters) if key == "q"]
        weight = weights[-1] if weights else "1"
        if _WEIGHT.match(weight):
            best = max(best, (fits[name], float(weight)))
    return best[1]


JSON = "application/json"

_DECODER = json.JSONDecoder()
_BEGIN, _NEXT = '{"items":[', ',"next":'

_LINK = {
    "description": 'the next page, `rel="next"`; missing on the last one',
    "schema": {"type": "string"},
    "example": '</api/v1/audit?limit=100&cursor=4711>; rel="next"',
}


def is_list(model: Any) -> bool:
    """Whether a route with this response model answers with a list."""
    return isinstance(model, type) and issubclass(model, Items)


async def as_asked(request: Request, page: Response) -> Response:
    """Return a page of a list in the media type that the request prefers, with the link to the next page."""
    if page.status_code != 200:
        return page
    text = bytes(page.body).decode()
    # The last member: within strings, the quotes around its name would be escaped.
    end = text.rindex(_NEXT)
    cursor = json.loads(text[end + len(_NEXT) : -1])
    page.headers["Vary"] = "Accept"
    if cursor is not None:
        page.headers["Link"] = f'<{_following(request.url, cursor)}>; rel="next"'
    accepted = ",".join(request.headers.getlist("accept"))
    if quality(accepted, NDJSON) <= quality(accepted, JSON):
        return page
    lines = await _lines(text[:end])
    headers = {name: value for name, value in page.headers.items() if not name.startswith("content-")}
    return Response(lines, headers=headers, media_type=NDJSON, background=page.background)


def describe(operation: dict[str, Any]) -> None:
    """Say in OpenAPI what every list has, where this operation is one."""
    answer = operation["responses"].get("200", {})
    content = answer.get("content", {})
    schema = content.get(JSON, {}).get("schema", {}).get("$ref", "")
    if "/Items_" not in schema:
        return
    answer["headers"] = {"Link": _LINK}
    # A later OpenAPI can name the schema of a line.
    content[NDJSON] = {"schema": {"type": "string", "description": "an item of the JSON a line"}}


def _following(url: URL, cursor: str) -> str:
    after = url.include_query_params(cursor=cursor)
    return f"{after.path}?{after.query}"


async def _lines(text: str) -> str:
    """Return the items, an item a line."""
    turns = Turns()
    lines = []
    at, last = len(_BEGIN), len(text) - 1
    while at < last:
        _, end = _DECODER.raw_decode(text, at)
        lines.append(text[at:end] + "\n")
        at = end + 1  # past the comma
        await turns.rest()
    return "".join(lines)
