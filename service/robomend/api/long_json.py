"""JSON answers that may be long, written in a thread: to write them takes up to tens of milliseconds."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterable
from typing import Any

from starlette.responses import Response

from robomend.diagnosis.result import DiagnosisResult
from robomend.oneshots.result_json import quoted_names, result_text

_text = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode


def page_text(items: Iterable[Any], following: str | None) -> bytes:
    """Return a page of a list; call it where the items are read, in a thread of the store's."""
    return f'{{"items":[{",".join(map(_text, items))}],"next":{_text(following)}}}'.encode()


def response_of(text: bytes) -> Response:
    """Return the answer that has this text."""
    return Response(text, media_type="application/json")


async def result_response(result: DiagnosisResult) -> Response:
    """Return an engine's answer as it is; ResultOut only describes it."""
    text = await asyncio.to_thread(result_text, result, quoted_names(result.components))
    return response_of(text.encode())


async def value_response(make: Callable[..., Any], given: list[Any]) -> Response:
    """Return the value that `make` makes of what is given.

    `given` is empty afterwards: what is large and nobody else has is freed in the thread that wrote it.
    """

    def written() -> bytes:
        text = _text(make(*given)).encode()
        given.clear()
        return text

    return response_of(await asyncio.to_thread(written))
