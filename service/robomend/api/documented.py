"""The error answers of the routes, for OpenAPI: which problems a kind of route can answer with.

Every route can be refused for lack of a key (401), of the right (403), for a Host or an Origin (421, 403),
for coming too often (429), and while the database is away (503); the rest is named where the route is
declared.
"""

from __future__ import annotations

from typing import Any

from robomend.api.problems import MEDIA_TYPE

TEXTS = {
    400: "Not JSON, or not HTTP as it should be",
    401: "A key is needed, or this one is unknown or revoked",
    403: "Policy, protection, role or origin says no",
    404: "There is no such thing",
    405: "The resource has no such method",
    408: "The body stalled",
    409: "The resource is not in the state that the request needs",
    412: "If-Match names another version",
    413: "The body is larger than allowed",
    415: "The body is of another kind",
    421: "The Host header names another computer",
    422: "A field, a sentence or a model is at fault",
    428: "Replacing needs If-Match",
    429: "Too many requests with one key; Retry-After says when",
    502: "A part behind the service refused",
    503: "Overloaded, shutting down, or a part behind the service is away; Retry-After says when",
    504: "A part behind the service did not answer in time",
    507: "The disk is full: reading goes on",
}

ALWAYS = (401, 403, 421, 422, 429, 503)
BODY = (400, 408, 413, 415, 507)

PROBLEM = {"schema": {"$ref": "#/components/schemas/ProblemBody"}}
"""A reference, as the framework would make a validator of a model for each of six hundred answers."""


def problems(*statuses: int, body: bool = False) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of a route with these problems besides those of every route."""
    wanted = {*ALWAYS, *statuses, *(BODY if body else ())}
    return {
        status: {"description": TEXTS[status], "content": {MEDIA_TYPE: PROBLEM}} for status in sorted(wanted)
    }
