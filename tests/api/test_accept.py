"""The header `Accept` is read as RFC 9110 has it: the most specific range counts, with its weight."""

from __future__ import annotations

import pytest

from robomend.api.lists import quality


@pytest.mark.parametrize(
    ("accept", "json", "ndjson"),
    [
        ("", 1, 1),
        ("*/*", 1, 1),
        ("application/*;q=0.5", 0.5, 0.5),
        ("application/x-ndjson", 0, 1),
        ("Application/X-NDJSON ; Q=0.7 , */*;q=0.1", 0.1, 0.7),
        ("application/x-ndjson;q=0, */*", 1, 0),
        ("*/*;q=0.9, application/json;q=0.3", 0.3, 0.9),
        ("text/html", 0, 0),
        ("application/json;charset=utf-8", 1, 0),
        ("application/json;q=2, application/x-ndjson;q=much", 0, 0),
        (", ;, application/json;q=1.000", 1, 0),
    ],
)
def test_a_media_type_is_wanted_as_much_as_the_range_that_fits_best(
    accept: str, json: float, ndjson: float
) -> None:
    assert quality(accept, "application/json") == json
    assert quality(accept, "application/x-ndjson") == ndjson
