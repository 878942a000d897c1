"""JSON answers that may be long, as text: to be put together in a thread, a piece at a time.

json.dumps keeps the interpreter for itself for as long as it writes, 20 ms for a page of a thousand
diagnoses, and whoever calls it on the event loop keeps that as well. Many short calls of it in a thread leave
room for everybody else: for a stop, say.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterable
from typing import Any

from starlette.responses import Response

from robomend.diagnosis.result import DiagnosisResult
from robomend.oneshots.result_json import quoted_names, result_json, result_text

SHORT = 2_000
"""Names of components in a result that is written at once: under a millisecond."""

_text = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode


def page_text(items: Iterable[Any], following: str | None) -> bytes:
    """Return a page of a list; call it where the items are read, in a thread of the store's."""
    return f'{{"items":[{",".join(map(_text, items))}],"next":{_text(following)}}}'.encode()


def response_of(text: bytes) -> Response:
    """Return the answer that has this text."""
    return Response(text, media_type="application/json")


async def result_response(result: DiagnosisResult) -> Response:
    """Return an engine's answer as it is; ResultOut only describes it."""
    if len(result.components) * len(result.diagnoses) <= SHORT:
        return response_of(_text(result_json(result)).encode())
    return response_of(await asyncio.to_thread(_long_result, result))


def _long_result(result: DiagnosisResult) -> bytes:
    return result_text(result, quoted_names(result.components)).encode()


async def value_response(make: Callable[..., Any], given: list[Any], size: int) -> Response:
    """Return the value that `make` makes of what is given, of about so many names.

    `given` is empty afterwards: what is large and nobody else has is freed in the thread that wrote it.
    """
    if size > SHORT:
        return response_of(await asyncio.to_thread(_written, make, given))
    return response_of(_written(make, given))


def _written(make: Callable[..., Any], given: list[Any]) -> bytes:
    text = _text(make(*given)).encode()
    given.clear()
    return text
