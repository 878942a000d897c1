"""The field of a body that was probably meant, for the error about one that is not known.

Which fields there are is read from the body's schema, down the place of the error:

    body.board.hots ──► fields of the body ──► those of `board`, whichever kind it may be ──► `host`
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

from pydantic import TypeAdapter

from robomend_client.near import did_you_mean

Schema = dict[str, Any]


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
