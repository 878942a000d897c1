"""What was measured, on its way to the service and to a person."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robomend_client.readings import MAX_TEXT, Reading, Symptom

TEXTS = st.text(max_size=600)
READINGS = st.builds(
    Reading,
    st.floats(allow_nan=False, allow_infinity=False) | TEXTS,
    TEXTS,
    TEXTS,
    st.none() | st.sampled_from(Symptom),
)


def test_a_person_reads_value_unit_and_limit() -> None:
    assert str(Reading(19.123, "V", "at least 22", Symptom.VALUE)) == "19.12 V, at least 22"
    assert str(Reading(16, "Hz", "50 ± 5")) == "16 Hz, 50 ± 5"
    assert str(Reading(10800, "s behind")) == "10800 s behind"
    assert str(Reading("exit code 1: cannot open /dev/lidar")) == "exit code 1: cannot open /dev/lidar"


def test_what_a_program_printed_last_is_made_fit_for_the_wire() -> None:
    printed = Reading("\x1b[31mcannot open\x00\n/dev/lidar\u202e", limit="x" * 900).as_json()
    assert printed == {"value": "[31mcannot open  /dev/lidar", "limit": "x" * (MAX_TEXT - 1) + "…"}
    assert Reading(float("inf"), "Hz").as_json() == {"value": "inf", "unit": "Hz"}


@given(READINGS)
def test_what_goes_over_the_wire_comes_back_as_it_went(reading: Reading) -> None:
    sent = Reading.from_json(reading.as_json())
    assert Reading.from_json(sent.as_json()) == sent
    assert sent.symptom is reading.symptom
    for text in (sent.value, sent.unit, sent.limit):
        assert not isinstance(text, str) or (text.isprintable() and len(text) <= MAX_TEXT)
