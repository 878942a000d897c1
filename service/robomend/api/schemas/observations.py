"""What was observed, and OBS."""

from __future__ import annotations

from math import isfinite
from typing import Annotated

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    GetPydanticSchema,
    PlainValidator,
    TypeAdapter,
    WithJsonSchema,
)
from pydantic.dataclasses import dataclass
from pydantic_core import core_schema

from robomend.api.schemas.base import MAX_INT, In, Moment, Nanoseconds, Out, Sentence, moment_of
from robomend.robots.batches import Batch
from robomend_client.readings import MAX_TEXT, Reading, Symptom


def _shown(text: str) -> str:
    """Refuse what is too long or does not print, as in a name. Markup is text: who shows it escapes it."""
    if len(text) > MAX_TEXT:
        raise ValueError(f"a text of {len(text)} characters; {MAX_TEXT} are taken: cut it")
    at = next((at for at, letter in enumerate(text) if not letter.isprintable()), None)
    if at is not None:
        raise ValueError(
            f"character {at} is a control character ({text[at]!a}); put a space, or what it stands for"
        )
    return text


def _measured(value: object) -> float | str:
    """Return a value as it is; one fault, not one for each type that it might have been."""
    if isinstance(value, str):
        return _shown(value)
    if isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value):
        return float(value)
    raise ValueError("a number or a text is wanted")


Shown = Annotated[str, AfterValidator(_shown), Field(json_schema_extra={"maxLength": MAX_TEXT})]
Measured = Annotated[
    float | str,
    PlainValidator(_measured),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "maxLength": MAX_TEXT}]}),
]


class ReadingBody(In):
    """What was measured beside a literal, for people; no rule reads it."""

    value: Measured = Field(
        examples=["0 of 10 Hz for 2.1 s"], description=f"a number, or a text of {MAX_TEXT} characters at most"
    )
    unit: Shown = Field(default="", examples=["V"])
    limit: Shown = Field(default="", examples=["at least 22"], description="what it is held against")
    symptom: Annotated[Symptom, Field(strict=False)] | None = Field(
        default=None, description="the kind of a bad verdict, by which remedies are chosen"
    )

    def reading(self) -> Reading:
        return Reading(self.value, self.unit, self.limit, self.symptom)


ReadingIn = Annotated[
    Reading,
    GetPydanticSchema(
        lambda _, handler: core_schema.no_info_after_validator_function(
            ReadingBody.reading, handler(ReadingBody)
        )
    ),
]


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class ObservationsBody(Batch):
    """One batch of sentences, observed by one source at one time."""  # within the limits of the wire

    observations: list[Sentence] = Field(
        default_factory=list,
        max_length=10_000,
        examples=[["not ok(scan)", "on(hokuyo)"]],
        json_schema_extra={"default": []},
    )
    assertions: dict[Annotated[str, Field(min_length=1, max_length=200)], Sentence] = Field(
        default_factory=dict,
        max_length=1000,
        description="named sentences, kept until they are withdrawn",
        json_schema_extra={"default": {}},
    )
    time_ns: Nanoseconds | None = Field(
        default=None, alias="time", strict=True, description="nanoseconds since the epoch; null: now"
    )
    source: Annotated[str, Field(min_length=1, max_length=200)] | None = Field(
        default=None, examples=["general_observer"], description="null: the name of the key"
    )
    lifetime_s: float | None = Field(
        default=None,
        gt=0,
        le=10 * 365 * 86400,
        strict=True,
        description="after it the literals are unknown",
    )
    together: bool = Field(
        default=True, strict=True, description="false: keep the good sentences of the batch, report the rest"
    )
    since: list[Nanoseconds | None] = Field(
        default_factory=list,
        max_length=10_000,
        description="for each observation the beginning of what it rests on, by the clock of `time`",
        json_schema_extra={"default": []},
    )
    onset: list[Nanoseconds | None] = Field(
        default_factory=list,
        max_length=10_000,
        description="for each observation the last good sample before it",
        json_schema_extra={"default": []},
    )
    unknown: list[Sentence] = Field(
        default_factory=list,
        max_length=10_000,
        description="atoms that are unknown from now on, to this source",
        json_schema_extra={"default": []},
    )
    settled: int | None = Field(
        default=None, ge=0, le=MAX_INT, strict=True, description="the `n` of the `settle` that this answers"
    )
    readings: list[ReadingIn | None] = Field(
        default_factory=list,
        max_length=10_000,
        description="for each observation what was measured; null: nothing",
        json_schema_extra={"default": []},
    )


OBSERVATIONS = TypeAdapter(ObservationsBody)


class RefusedSentence(Out):
    """A sentence that was not kept, and why."""

    sentence: str
    position: int
    message: str


class Accepted(Out):
    """What became of a batch. `changed` are the literals that OBS now holds anew."""

    revision: int
    changed: list[str]
    refused: list[RefusedSentence] = Field([])


class Ingested(Out):
    """What became of an NDJSON stream."""

    revision: int
    lines: int
    accepted: int


class ReadingOut(Out):
    """What was measured, and all of it as one text."""

    value: float | str = Field(examples=[19.1])
    unit: str = Field("", examples=["V"])
    limit: str = Field("", examples=["at least 22"])
    symptom: Symptom | None = None
    text: str = Field(examples=["19.1 V, at least 22"])


class SourceWord(Out):
    """The last word of one source."""

    literal: str = Field(examples=["not ok(scan)"])
    source: str
    time_ns: int
    time: Moment = moment_of("time_ns")
    expires_ns: int | None = None
    expires: Moment | None = moment_of("expires_ns")
    since_ns: int | None = None
    since: Moment | None = moment_of("since_ns")
    onset_ns: int | None = Field(None, description="the beginning of saying so")
    onset: Moment | None = moment_of("onset_ns")
    reading: ReadingOut | None = None


class ObservedLiteral(Out):
    """One literal of OBS."""

    literal: str = Field(examples=["not ok(scan)"])
    source: str
    time_ns: int
    time: Moment = moment_of("time_ns")
    expires_ns: int | None = None
    expires: Moment | None = moment_of("expires_ns")
    since_ns: int | None = Field(None, description="the beginning of what it rests on, by our clock")
    since: Moment | None = moment_of("since_ns")
    onset_ns: int | None = Field(None, description="the last good sample before it turned bad")
    onset: Moment | None = moment_of("onset_ns")
    confirmed: bool = Field(True, description="false: from before an act that may have changed it")
    fresh: bool = Field(description="false: it is unknown: outlived, or contradicted")
    used: bool = Field(description="false: no rule of the model mentions it")
    reading: ReadingOut | None = Field(None, description="what was measured, in the newest report")
    contradicted: bool = Field(False, description="true: sources contradict each other, and it is unknown")
    by_source: list[SourceWord] = Field([], description="where several sources speak of it, what each says")


class AssertionOut(Out):
    """A named sentence of OBS."""

    name: str
    sentence: str
    source: str
    time_ns: int
    time: Moment = moment_of("time_ns")
    expires_ns: int | None = None
    expires: Moment | None = moment_of("expires_ns")


class ObsOut(Out):
    """OBS now."""

    revision: int
    observations: list[ObservedLiteral]
    assertions: list[AssertionOut]
