"""A result as JSON values and as text: the same, whatever the names are."""

from __future__ import annotations

import json
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.result import Conflict, Diagnosis, DiagnosisResult, Factor
from robomend.oneshots.result_json import quoted_names, result_json, result_text, timed, timeless
from robomend_client.literals import fails

AGREED = ["diagnoses", "complete", "stopped_by", "conflicts"]

names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12) | st.sampled_from(
    ['"good":null', "good", '"', "\\", ',"elapsed_s":', "élan", "\x00"]
)


@st.composite
def results(draw: st.DrawFn) -> DiagnosisResult:
    """A result over components of any names; what an engine would find is not asked here."""
    components = tuple(draw(st.lists(names, min_size=1, max_size=6, unique=True)))
    some = st.lists(st.sampled_from(components), unique=True, max_size=3).map(tuple)
    conflicts = tuple(
        Conflict(
            draw(some),
            (unmet := fails("ok", draw(names)),),
            (draw(names),),
            draw(names),
            draw(st.sampled_from([None, unmet])),
            draw(st.booleans()),
        )
        for _ in range(draw(st.integers(0, 2)))
    )
    diagnoses = tuple(
        Diagnosis(
            draw(some),
            draw(st.none() | st.floats(0, 1)),
            {name: draw(names) for name in draw(some)},
            tuple(range(len(conflicts))),
        )
        for _ in range(draw(st.integers(0, 3)))
    )
    return DiagnosisResult(
        components,
        diagnoses,
        draw(st.booleans()),
        draw(st.sampled_from([None, "limit", "size", "time"])),
        conflicts,
        draw(st.floats(0, 100)),
        (fails("on", draw(names)),),
        tuple((Factor(name, draw(some), (draw(some),)),) for name in draw(some)),
        draw(st.none() | st.integers(0, 10**30)),
        draw(st.none() | st.floats(0, 1)),
        {name: draw(names) for name in draw(some)},
        draw(st.booleans()),
    )


@given(results())
def test_the_text_is_the_values(result: DiagnosisResult) -> None:
    values, text = result_json(result), result_text(result, quoted_names(result.components))
    assert json.loads(text) == values == json.loads(json.dumps(values))
    assert [key for key in values if key in AGREED] == AGREED
    assert [*values][-1] == "elapsed_s"


@given(results(), st.floats(0, 1000))
def test_the_time_can_be_exchanged_and_left_out(result: DiagnosisResult, elapsed_s: float) -> None:
    quoted = quoted_names(result.components)
    text = result_text(result, quoted)
    other = json.loads(timed(timeless(text), elapsed_s))
    assert other == {**json.loads(text), "elapsed_s": round(elapsed_s, 6)}
    assert timeless(text) == timeless(result_text(replace(result, elapsed_s=elapsed_s), quoted))
