"""Values to columns: an object that brings its text is written as that text."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from robomend.store.encoding import Encoded, from_json, to_json

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@given(st.dictionaries(st.text(), VALUES, max_size=4))
def test_an_encoded_object_is_the_object(value: dict[str, object]) -> None:
    encoded = Encoded(value)
    assert encoded == value
    assert to_json(encoded) == to_json(value)
    assert from_json(to_json(encoded)) == value
    assert json.loads(json.dumps({"inside": encoded})) == {"inside": value}


def test_a_text_that_was_made_elsewhere_is_taken_as_it_is() -> None:
    assert to_json(Encoded({"a": 1}, '{"a":1}')) == '{"a":1}'
