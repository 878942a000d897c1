"""One error shape: problem details (RFC 9457) with a stable `code`.

Every RobomendError has a status here, by its most special class; HTTP's own errors (a body too large, a key
missing) are `Problem`s raised where they are found. Nothing else makes an error response, and a request is
never answered with a traceback: an exception that nobody foresaw is logged with its request id and answered
with 500.

The error about a field that is not known names the one that was probably meant. Which fields there are is
read from the body's schema, down the place of the error:

    body.board.hots ──► fields of the body ──► those of `board`, whichever kind it may be ──► `host`
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from pydantic import TypeAdapter, ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from robomend import errors
from robomend.batches.batches import BatchUnavailable
from robomend.memory_limits import out_of_memory
from robomend_client.near import did_you_mean

Schema = dict[str, Any]

GONE = 499
"""Of a request whose client went away: nobody is left to answer, the log line and the metrics say so."""


def near_field(kind: Any, place: Sequence[int | str]) -> str:
    """Return `; did you mean 'policy'?` for an unknown field; nothing where none is near.

    Args:
        kind: the type of the body.
        place: of the field, as pydantic says it.
    """
    whole = _schema(kind)
    here = list(_kinds(whole, whole))
    for step in place[:-1]:
        here = [one for above in here for one in _below(above, step, whole)]
    return did_you_mean(str(place[-1]), {name for one in here for name in one.get("properties", ())})


@lru_cache(maxsize=64)
def _schema(kind: Any) -> Schema:
    return TypeAdapter(kind).json_schema()


def _kinds(schema: Schema, whole: Schema) -> Iterator[Schema]:
    """Yield what a value may be: the schema, or those that it chooses from."""
    if "$ref" in schema:
        yield from _kinds(whole["$defs"][schema["$ref"].rpartition("/")[2]], whole)
    for word in ("anyOf", "oneOf", "allOf"):
        for one in schema.get(word, ()):
            yield from _kinds(one, whole)
    yield schema


def _below(schema: Schema, step: int | str, whole: Schema) -> Iterator[Schema]:
    """Yield what a value may be that is one step down; nothing if the step leads nowhere."""
    if isinstance(step, int):
        found = [schema.get("items")]
    elif step in schema.get("properties", ()):
        found = [schema["properties"][step]]
    else:
        found = [schema.get("additionalProperties"), *schema.get("patternProperties", {}).values()]
    for one in found:
        if isinstance(one, dict):
            yield from _kinds(one, whole)


log = structlog.get_logger("robomend.api")

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:robomend:problem:"

STATUS: dict[type[errors.RobomendError], int] = {
    errors.RobomendError: 500,
    errors.InputError: 422,
    errors.MalformedJson: 400,
    errors.TooLarge: 413,
    errors.NotFound: 404,
    errors.StateConflict: 409,
    errors.PreconditionFailed: 412,
    errors.PreconditionRequired: 428,
    errors.Refused: 403,
    errors.BackendError: 502,
    BatchUnavailable: 503,
    errors.SolverError: 503,
    errors.WorkerDied: 503,
    errors.WorkerTimeout: 503,
    errors.WorkerNotReady: 503,
    errors.Overloaded: 503,
    errors.StoreError: 503,
    errors.StoreFull: 507,
    errors.BoardTimeout: 504,
    errors.BoardUnreachable: 503,
}

RETRY_AFTER_S = {503: 1, 429: 1}

HTTP_CODES = {
    400: "bad-request",
    401: "unauthorized",
    403: "forbidden",
    404: "not-found",
    405: "method-not-allowed",
    406: "not-acceptable",
    408: "request-timeout",
    411: "length-required",
    413: "too-large",
    415: "unsupported-media-type",
    421: "misdirected",
    422: "bad-input",
    429: "too-many-requests",
    431: "headers-too-large",
    500: "internal",
    501: "not-implemented",
    503: "overloaded",
    505: "http-version",
}

MAX_FIELDS = 20
"""Faults named in one answer; a body of a million wrong fields must not be answered with a million lines."""


EXTRA = "extra_forbidden"
"""What pydantic calls a field that there is not."""


class Problem(Exception):
    """An answer that is no success, raised where it is found."""

    def __init__(
        self,
        status: int,
        detail: str,
        *,
        code: str | None = None,
        headers: Mapping[str, str] | None = None,
        **extra: Any,
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail
        self.code = code or HTTP_CODES.get(status, "error")
        self.headers = dict(headers or {})
        self.extra = extra

    @property
    def title(self) -> str:
        """The status in words."""
        return HTTPStatus(self.status).phrase

    def response(self, request_id: str | None = None) -> Response:
        """Return the response; strings that UTF-8 cannot carry are escaped."""
        body: dict[str, Any] = {
            "type": TYPE_PREFIX + self.code,
            "title": self.title,
            "status": self.status,
            "code": self.code,
            "detail": self.detail,
            **self.extra,
        }
        if request_id is not None:
            body["request_id"] = request_id
        if self.status in RETRY_AFTER_S:
            self.headers.setdefault("Retry-After", str(RETRY_AFTER_S[self.status]))
        return Response(json.dumps(body), self.status, self.headers, MEDIA_TYPE)


def of_error(error: errors.RobomendError) -> Problem:
    """Return the problem of a service error: its status, its code, its place as fields of their own."""
    status = next(STATUS[cls] for cls in type(error).__mro__ if cls in STATUS)
    extra: dict[str, Any] = {}
    for name in ("file", "line", "sentence", "position", "literals", "rules"):
        value = getattr(error, name, None)
        if value is not None and value != ():
            extra[name] = list(value) if isinstance(value, tuple) else value
    return Problem(status, str(error) or error.code, code=error.code, **extra)


def of_body(error: ValidationError, kind: Any) -> Problem:
    """Return 422 for a body that was no such `kind`, naming each field at fault."""
    faults = [{**fault, "loc": ("body", *fault["loc"])} for fault in error.errors(include_url=False)]
    return of_validation(RequestValidationError(faults), kind)


def of_validation(error: RequestValidationError, kind: Any = None) -> Problem:
    """Return 400 for what is no JSON and 422 for what is none of ours, naming each field at fault.

    Args:
        kind: the type that the body should have had, where there is one.
    """
    found = error.errors()
    if found and found[0]["type"] == "json_invalid":
        position = found[0]["loc"][-1]
        reason = found[0].get("ctx", {}).get("error", "not JSON")
        return Problem(400, f"the body is not JSON: {reason} at {position}", code="malformed-json")
    for one in found:
        if one["type"] == "unexpected_keyword_argument":  # a field of a body that is checked as a dataclass
            one["type"], one["msg"] = EXTRA, "Extra inputs are not permitted"
    for one in found[:MAX_FIELDS]:
        if kind is not None and one["type"] == EXTRA and one["loc"][0] == "body":
            one["msg"] += near_field(kind, one["loc"][1:])
    faults = [
        {"place": ".".join(map(str, one["loc"])), "message": one["msg"], "type": one["type"]}
        for one in found[:MAX_FIELDS]
    ]
    first = f"{faults[0]['place']}: {faults[0]['message']}" if faults else "the request is malformed"
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return Problem(422, first + more, errors=faults)


def answer_to(request: Request, error: errors.RobomendError | Problem) -> Response:
    """Return the answer that an error of ours is; what failed behind us is logged."""
    if isinstance(error, Problem):
        return error.response(request_id(request))
    problem = of_error(error)
    if problem.status >= 500:
        log.warning("backend failed", code=problem.code, detail=problem.detail)
    return problem.response(request_id(request))


def install(app: FastAPI) -> None:
    """Make every error of this application a problem."""

    async def ours(request: Request, error: Exception) -> Response:
        assert isinstance(error, errors.RobomendError | Problem)
        return answer_to(request, error)

    async def invalid(request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        field = getattr(request.scope.get("route"), "body_field", None)
        kind = None if field is None else field.field_info.annotation
        return of_validation(error, kind).response(request_id(request))

    async def http_error(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        detail = str(error.detail)
        if error.status_code == 404:
            detail = f"there is nothing at {request.url.path}"
        return Problem(error.status_code, detail, headers=error.headers).response(request_id(request))

    async def gone(request: Request, error: Exception) -> Response:
        return Response(status_code=GONE)

    async def bug(request: Request, error: Exception) -> Response:
        return unforeseen(request_id(request), error)

    app.add_exception_handler(errors.RobomendError, ours)
    app.add_exception_handler(Problem, ours)
    app.add_exception_handler(RequestValidationError, invalid)
    app.add_exception_handler(HTTPException, http_error)
    app.add_exception_handler(ClientDisconnect, gone)
    app.add_exception_handler(Exception, bug)


def unforeseen(request_id: str | None, error: Exception) -> Response:
    """Return the answer to an exception that nobody foresaw; the log has the rest."""
    if out_of_memory(error):
        why = "this process may have no more memory (`ulimit -v`, a cgroup); try again later"
        return Problem(503, why, code="overloaded").response(request_id)
    return Problem(500, "an unforeseen fault; the log tells more under this request id").response(request_id)


def request_id(request: Request) -> str | None:
    """Return the id that the outermost middleware gave to the request."""
    value = request.scope.get("robomend.request_id")
    return value if isinstance(value, str) else None


# --- the error answers of the routes, for OpenAPI: which problems a kind of route can answer with.
#
# Every route can be refused for lack of a key (401), of the right (403), for a Host or an Origin (421,
# 403), for coming too often (429), and while the database is away (503); the rest is named where the route
# is declared.

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
