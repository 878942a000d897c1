"""The JSON bodies that come back, as types. A newer service may send more keys than these."""

from __future__ import annotations

import sys
from typing import Any, Generic, Literal, TypedDict, TypeVar

T = TypeVar("T")


if sys.version_info >= (3, 11):

    class Page(TypedDict, Generic[T]):
        """A part of a list; `next` is the cursor of the rest, or None at the end."""

        items: list[T]
        next: str | None

else:  # 3.10 has no generic ones; types are checked by a newer Python

    class Page(TypedDict):
        """A part of a list; `next` is the cursor of the rest, or None at the end."""

        items: list[Any]
        next: str | None


class RefusedSentence(TypedDict):
    """A sentence that was not kept, and why; the position is 0-based."""

    sentence: str
    position: int
    message: str


class Accepted(TypedDict):
    """The answer to a batch: the revision of OBS that holds it, and the literals that are new in it."""

    revision: int
    changed: list[str]
    refused: list[RefusedSentence]


class Ingested(TypedDict):
    """The answer to NDJSON."""

    revision: int
    lines: int
    accepted: int


class ReadingJson(TypedDict, total=False):
    """What was measured; see robomend_client.readings."""

    value: float | str
    unit: str
    limit: str
    symptom: str | None


class ObservedLiteral(TypedDict):
    """A literal of OBS; not fresh is unknown."""

    literal: str
    source: str
    time_ns: int
    expires_ns: int | None
    fresh: bool
    used: bool
    reading: ReadingJson | None
    contradicted: bool
    by_source: list[dict[str, Any]]


class Obs(TypedDict):
    """OBS as it is now."""

    revision: int
    observations: list[ObservedLiteral]
    assertions: list[dict[str, Any]]


class Diagnosis(TypedDict):
    """A minimal diagnosis: bad ∪ good = C; the probability is null without priors."""

    bad: list[str]
    good: list[str]
    probability: float | None
    modes: dict[str, str]
    text: str


class ConflictSet(TypedDict):
    """Components of which at least one is bad, and why."""

    components: list[str]
    observations: list[str]
    rules: list[str]
    text: str


class Result(TypedDict):
    """An engine's answer: complete, or stopped by limit, size or time. One empty diagnosis is healthy."""

    diagnoses: list[Diagnosis]
    complete: bool
    stopped_by: Literal["limit", "size", "time"] | None
    conflicts: list[ConflictSet]
    elapsed_s: float


class Fault(TypedDict):
    """Why there is no result."""

    code: str
    detail: str


class CurrentDiagnosis(TypedDict):
    """The diagnosis of a robot's OBS at `revision`; without a result, `fault` says why."""

    robot: str
    revision: int
    model_version: str | None
    time_ns: int | None
    expected_stopped: list[str]
    result: Result | None
    fault: Fault | None
    findings: list[str]


class Probe(TypedDict):
    """An observation worth making."""

    atom: str
    gain_bits: float
    cost_s: float
    if_true: list[list[str]]
    if_false: list[list[str]]


class Probes(TypedDict):
    """What to look at next, best first."""

    revision: int
    probes: list[Probe]
    entropy_bits: float
    complete: bool
    reason: str | None


class StatusLine(TypedDict):
    """How a robot is, what is wrong with it and what it waits for."""

    robot: str
    model: str
    policy: str
    state: str | None
    headline: str
    finding: str
    more: int
    waits: str
    waits_for_person: bool
    since_ns: int | None


class Status(TypedDict):
    """A page of the robots, the most urgent first."""

    robots: list[StatusLine]
    found: int
    total: int
    counts: dict[str, int]
    page: int
    pages: int
    complete: bool


class Stop(TypedDict):
    """The global stop."""

    active: bool
    by: str | None
    reason: str
    since_ns: int | None
    written: bool
    detail: str


class Channel(TypedDict):
    """A power channel; None is unknown."""

    channel: int
    component: str | None
    on: bool | None
    current_a: float | None
    voltage_v: float | None
    protected: bool


class Board(TypedDict):
    """The robot's power board and the link to it."""

    host: str
    port: int
    state: str
    reason: str
    time_ns: int
    channels: list[Channel]


class FiveKeys(TypedDict):
    """The model that a robot follows, as propositions and clauses."""

    model: str
    version: str
    ab: str
    nab: str
    neg_prefix: str
    props: list[str]
    rules: list[str]


class FirstResult(TypedDict):
    """The result of an action that counts: that of the first report."""

    code: int
    message: str


HistoryKind = Literal["observations", "diagnosis", "repair"]
