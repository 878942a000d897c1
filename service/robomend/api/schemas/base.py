"""What comes in and goes out over HTTP: types, limits and examples. The core never sees these classes.

Unknown fields of a request are refused, so that a misspelt one is not silently without effect. Keys are the
words of the literature; AB(c) is `bad` here, as in the paper.
"""

from __future__ import annotations

from typing import Annotated, Any, Generic, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from robomend.timestamps import rfc3339

T = TypeVar("T")

MAX_INT = 2**63 - 1

NAME = r"^[A-Za-z0-9][A-Za-z0-9._\-]{0,63}$"
RobotId = Annotated[str, Field(pattern=NAME, examples=["tedusar-1"])]
ModelName = Annotated[str, Field(pattern=NAME, examples=["tedusar"])]
Component = Annotated[str, Field(min_length=1, max_length=200, examples=["jaguar"])]
Sentence = Annotated[str, Field(min_length=1, max_length=4000, examples=["not ok(scan)"])]
Nanoseconds = Annotated[int, Field(ge=0, le=MAX_INT, examples=[1764000000000000000])]
Moment = Annotated[
    str,
    Field(
        json_schema_extra={"format": "date-time"},
        description="RFC 3339, in UTC, beside the nanoseconds, which JavaScript cannot hold",
        examples=["2025-11-24T16:00:00.123Z"],
    ),
]


def one_line(text: str) -> str:
    """Return a text as one line that shows as it reads: it stands in lists, logs and mails beside others'."""
    return "".join(one if one.isprintable() else " " if one.isspace() else "?" for one in text)


Reason = Annotated[str, Field(max_length=1000, examples=["the laser was cleaned"]), AfterValidator(one_line)]


class In(BaseModel):
    """A request body. Nothing is converted: `true` is no time, and "5" no number."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True, strict=True)


def _with_moments(schema: dict[str, Any]) -> None:
    """A moment's text is there wherever its nanoseconds are."""
    required = schema.get("required", [])
    texts = (name.removesuffix("_ns") for name in list(required) if name.endswith("_ns"))
    required.extend(text for text in texts if text not in required)


class Out(BaseModel):
    """An answer; new fields may come, so clients skip those that they do not know."""

    model_config = ConfigDict(frozen=True, json_schema_extra=_with_moments)


def moment_of(nanoseconds: str, **told: Any) -> Any:
    """Return a field that says as text what the field `nanoseconds`, which stands before it, says."""
    return Field(default_factory=lambda known: rfc3339(known.get(nanoseconds)), **told)


class ProblemBody(Out):
    """Problem details (RFC 9457); `code` is stable, `detail` is for people."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(examples=["urn:robomend:problem:not-found"])
    title: str = Field(examples=["Not Found"])
    status: int = Field(examples=[404])
    code: str = Field(examples=["not-found"])
    detail: str = Field(examples=["there is no robot 'r2'"])
    request_id: str | None = Field(default=None, examples=["5f0c9a"])


class Items(Out, Generic[T]):
    """One page of a list; `next` is the cursor of the following one, null on the last."""

    items: list[T]
    next: str | None = Field(default=None, examples=[None])
