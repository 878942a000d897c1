"""Questions to the engines, and their answers."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import Component, In, ModelName, Moment, Out, Sentence, moment_of
from robomend.api.schemas.robots import DiagnosisOptionsBody


class DiagnosisOut(Out):
    """A minimal diagnosis: these are bad, all others good."""

    bad: list[str] = Field(examples=[["hokuyo"]])
    good: list[str] = Field(examples=[["jaguar", "imu"]])
    probability: float | None = None
    modes: dict[str, str] = Field(default={}, description="component -> fault mode that fits")
    resolves: list[int] = Field(default=[], description="the conflicts that it hits, by their index")
    text: str = Field(examples=["hokuyo explains not ok(scan)"])


class ConflictOut(Out):
    """Components that cannot all be healthy, given these observations."""

    components: list[str]
    observations: list[str]
    rules: list[str]
    text: str
    unmet: str | None = Field(default=None, description="the one of the observations that was not expected")
    minimal: bool = Field(default=True, description="false: not each component was made sure to be needed")


class FactorOut(Out):
    """A diagnosis takes one of the alternatives, or all components of one of the sets."""

    component: str = Field(description="the first of them")
    alternatives: list[str]
    sets: list[list[str]] = Field(default=[])


class ResultOut(Out):
    """The answer of an engine. One empty diagnosis means healthy."""

    diagnoses: list[DiagnosisOut]
    complete: bool
    stopped_by: Literal["limit", "size", "time"] | None
    smallest_proved: bool = Field(
        default=True, description="false: time or size ended the search; there may be smaller diagnoses"
    )
    size_at_least: int | None = Field(
        default=None, description="no diagnosis has fewer components; null: not known"
    )
    size_at_most: int | None = Field(
        default=None, description="the smallest diagnosis has no more components; null: not known"
    )
    conflicts: list[ConflictOut]
    conflicts_complete: bool = Field(
        default=True, description="false: no time, or no room, for all that the diagnoses rest on"
    )
    conflicts_all: bool = Field(
        default=False, description="true: these are all minimal conflicts that there are"
    )
    learned: dict[str, str] = Field(default={}, description="observation -> whom it raises suspicion of")
    cleared: dict[str, str] = Field(default={}, description="healthy suspect -> why it is cleared")
    unused: list[str] = Field(default=[], description="observations that no rule mentions")
    unexplored: float | None = Field(
        default=None, description="at most so much prior probability was not looked at; null without priors"
    )
    factored: list[list[FactorOut]] = Field(
        default=[],
        description="every diagnosis, as products: where asked for, and where there are more than the limit; "
        "a row is a product of factors, and no two rows share a diagnosis",
    )
    count: int | None = Field(
        default=None, description="how many diagnoses there are, listed or not; null: not known"
    )
    elapsed_s: float = Field(description="the diagnosis alone, without compilation")


class FaultOut(Out):
    """Why there is no result for these observations."""

    code: str
    detail: str


class CurrentDiagnosis(Out):
    """The diagnosis of a robot's OBS at `revision`."""

    robot: str
    revision: int
    model_version: str | None
    time_ns: int | None
    time: Moment | None = moment_of("time_ns")
    result: ResultOut | None = Field(
        description="null: there is none; `fault` says why, or nothing was diagnosed yet"
    )
    fault: FaultOut | None = None
    expected_stopped: list[str] = Field(
        default=[], description="nodes that are meant to be stopped: that they do not run is no fault here"
    )
    findings: list[str] = Field(
        default=[], description="about what sources contradict each other now, which no diagnosis explains"
    )


class AskOptionsBody(DiagnosisOptionsBody):
    """How far the engine searches, and what it tells."""

    conflicts: bool | Literal["all"] = Field(
        default=True,
        description="true: enough conflicts to show why each component is blamed; false: none; all: all "
        "minimal ones, as far as there is time and room",
    )


class AskBody(In):
    """A stateless diagnosis: model and observations in, result out."""

    model: ModelName | None = Field(default=None, description="a stored model; or `source`")
    source: str | None = Field(
        default=None, min_length=1, max_length=64 << 20, description="a model's text; or `model`"
    )
    observations: list[Sentence] = Field(default=[], max_length=10_000, examples=[["not ok(scan)"]])
    healthy: list[Component] = Field(
        default=[], max_length=10_000, description="what if these were healthy …"
    )
    abnormal: list[Component] = Field(default=[], max_length=10_000, description="… and these abnormal?")
    options: AskOptionsBody = Field(default_factory=AskOptionsBody)


class ProbeOut(Out):
    """An observation worth making next."""

    atom: str = Field(examples=["ok(map)"])
    gain_bits: float = Field(description="expected information")
    cost_s: float
    if_true: list[list[str]] = Field(description="the diagnoses that predict true …")
    if_false: list[list[str]] = Field(description="… and false; the others allow both")


class ProbesOut(Out):
    """What to look at next, best first."""

    revision: int
    probes: list[ProbeOut]
    entropy_bits: float = Field(description="how uncertain the diagnosis is; no probe can tell more")
    complete: bool = Field(description="every observable and every diagnosis found was considered")
    reason: str | None = Field(description="why no probe can discriminate")
